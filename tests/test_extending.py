"""Every block of docs/extending.md runs as it stands there, under the file name it gives."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()
SECTIONS = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL))
YOURS = [title for title in SECTIONS if title.endswith("(yours)")]


def blocks(text: str, *languages: str) -> list[str]:
    return re.findall(rf"```(?:{'|'.join(languages)})\n(.*?)```", text, flags=re.DOTALL)


def write_files(text: str, folder: Path) -> None:
    """Write every block to the file that its first line names, or add its rows there."""
    for block in blocks(text, "python", "yaml"):
        name, rows = re.fullmatch(r"# (\S+?)(: rows)?", block.splitlines()[0]).groups()
        path = folder / name
        if rows:
            add_rows(path, block.splitlines()[1:])
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.partition("\n")[2])


def add_rows(path: Path, rows: list[str]) -> None:
    """Imports go beside the others, entries into the table or among the members."""
    text = path.read_text()
    for row in rows:
        if row.startswith("from"):
            text = text.replace("\nfrom skipnet", f"\n{row}\nfrom skipnet", 1)
        else:
            table = r"(?:_READERS|PROPOSE)\b[^\n]*= \{\n|class Generator\(Enum\):\n[^\n]*\n\n"
            place = re.search(table, text).end()
            text = text[:place] + row + "\n" + text[place:]
    path.write_text(text)


def run(line: str, folder: Path, package: Path) -> subprocess.CompletedProcess[str]:
    _, script, *arguments = shlex.split(line)
    command = [sys.executable, str(package / script), *arguments]
    path = os.pathsep.join([str(folder), str(package)])
    env = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)


def test_the_page_has_what_it_promises():
    assert len(YOURS) == 3 and len(SECTIONS) == 5


@pytest.mark.parametrize("title", YOURS)
def test_what_is_yours_needs_no_change_of_the_package(tmp_path, title):
    # The data set is judged with the method of the page.
    write_files("".join(SECTIONS[one] for one in YOURS), tmp_path)
    for line in blocks(SECTIONS[title], "bash"):
        done = run(line, tmp_path, ROOT)
        assert done.returncode == 0, done.stderr
    assert any((tmp_path / "runs").iterdir())


def test_a_format_and_a_generator_are_a_file_and_their_rows(tmp_path):
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "skipnet", tmp_path / "skipnet", ignore=ignored)
    shutil.copy(ROOT / "register.py", tmp_path)
    write_files(SECTIONS["A file format"] + SECTIONS["A generator of hypotheses"], tmp_path)
    [line] = blocks(SECTIONS["A generator of hypotheses"], "bash")
    done = run(line, tmp_path, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "registered" in done.stdout
    script = (
        "import numpy as np, skipnet\n"
        "points = np.arange(12, dtype='<f4').reshape(4, 3)\n"
        "open('scan.xyz32', 'wb').write(points.tobytes())\n"
        "print((skipnet.read_points('scan.xyz32') == points).all(), skipnet.__file__)\n"
    )
    command = [sys.executable, "-c", script]
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    read = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True)
    assert read.stdout.split() == ["True", str(tmp_path / "skipnet" / "__init__.py")], read.stderr
