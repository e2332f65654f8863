"""Every command and snippet of the README and of docs/ works as it stands there.

Runs of register.py are tested in test_register_cli.py, those of the other scripts in their own
tests; here each command line is composed as written (``--cfg job``), so that no option in the
README is ever stale.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from skipnet.clouds.formats.reading import SUPPORTED
from skipnet.clouds.formats.writing import write_cloud
from skipnet.simulation.scanning.pairs import simulate_pair

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
README = "\n".join(page.read_text() for page in PAGES)
# What docs/extending.md shows needs the files that it tells to write: test_extending.py runs it.
TRIED = "\n".join(page.read_text() for page in PAGES if page.name != "extending.md")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", TRIED, flags=re.DOTALL)


COMMANDS = list(dict.fromkeys(line for block in blocks("bash") for line in block.splitlines()))


SCRIPTS = [line for line in COMMANDS if line.startswith(("python ", "skipnet "))]


@pytest.mark.parametrize("line", SCRIPTS)
def test_the_options_of_every_command_exist(tmp_path, line):
    first, second, *arguments = shlex.split(line)
    script = [str(ROOT / second)] if first == "python" else ["-m", "skipnet", second]
    if second == "study":
        script.append(arguments.pop(0))
    arguments = [argument for argument in arguments if argument != "--multirun"]
    if "--multirun" in line:
        arguments = [argument.split(",")[0] for argument in arguments]
    command = [sys.executable, *script, *arguments, "--cfg", "job"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert "output_dir: " in run.stdout


@pytest.mark.parametrize("line", [line for line in COMMANDS if line not in SCRIPTS])
def test_every_other_command_is_a_target_of_make(line):
    assert line.startswith("make ")
    subprocess.run(["make", "-n", *line.split()[1:]], cwd=ROOT, check=True, capture_output=True)


@pytest.mark.parametrize("snippet", dict.fromkeys(blocks("python")))
def test_the_python_snippets_run(tmp_path, monkeypatch, capsys, snippet):
    pair = simulate_pair("paper_room", seed=2, points=30_000).pair
    write_cloud(tmp_path / "a.ply", pair.source_m)
    write_cloud(tmp_path / "b.ply", pair.target_m)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(snippet, names)
    assert capsys.readouterr().out.startswith("registered")
    if "aligned" in snippet:
        assert len(names["aligned"]) == len(pair.source_m)


def test_every_supported_extension_is_named():
    assert [extension for extension in SUPPORTED if f"`{extension}`" not in README] == []


def test_the_files_and_rooms_it_names_exist():
    for path in re.findall(r"`((?:skipnet|tests|configs)/[\w./]*)`", README):
        assert (ROOT / path).exists(), path
    rooms = set(re.findall(r"`(\w+)/?`", README.split("| room |")[1].split("Conventions")[0]))
    present = {path.stem for path in (ROOT / "skipnet").iterdir() if path.name[0] not in "_."}
    present.remove("py")  # py.typed
    assert rooms == present


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text())
    assert [link for link in links if not (page.parent / link).exists()] == []
