"""What is compiled depends on its own file alone, and a stale or missing cache does no harm."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "skipnet"
DECORATORS = {"compiled", "inlined"}


def names_in(*nodes: ast.AST) -> set[str]:
    return {part.id for node in nodes for part in ast.walk(node) if isinstance(part, ast.Name)}


def foreign_names(source: str) -> set[str]:
    """Names imported from skipnet that a compiled function of a module uses."""
    tree = ast.parse(source)
    imported = {"skipnet"} | {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("skipnet")
        for alias in node.names
    }
    for node in tree.body:  # what is computed from it is foreign too
        if isinstance(node, ast.Assign) and names_in(node.value) & imported:
            imported |= names_in(*node.targets)
    used = set()
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef) and any(
            isinstance(by, ast.Name) and by.id in DECORATORS for by in function.decorator_list
        ):
            used |= names_in(*function.body)
    return imported & used


MODULES = [
    path
    for path in sorted(ROOT.rglob("*.py"))
    if "@compiled\n" in path.read_text() and path.name != "compiled.py"
]


def test_there_are_compiled_functions_to_check():
    assert len(MODULES) > 5


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_compiled_functions_use_nothing_from_other_files(path):
    # numba would not notice that the other file has changed, and run what it compiled before.
    assert foreign_names(path.read_text()) == set()


def test_a_name_from_another_file_would_be_noticed():
    source = (
        "from skipnet.compiled import compiled\nfrom skipnet.skipmap.cells import pack as p\n"
        "@compiled\ndef f(x: p) -> int:\n    return g(x)\n@compiled\ndef g(x):\n    return p(x)\n"
    )
    assert foreign_names(source) == {"p"}
    source = (
        "import skipnet.geometry\nfrom skipnet.skipmap.cells import BITS\nTWICE = 2 * BITS\n"
        "OWN = 3\n@inlined\ndef f(x):\n    return x + TWICE + OWN + skipnet.geometry._SAMPLE\n"
    )
    assert foreign_names(source) == {"TWICE", "skipnet"}


SCRIPT = """
import numpy as np
from skipnet.clouds.statistics import bounds
low_m, high_m = bounds(np.array([[1.0, 5.0, 0.0], [3.0, 2.0, 0.0]]))
print(low_m.tolist(), high_m.tolist())
"""


def run_anew(folder: Path, **variables: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=folder,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout.strip()


def test_where_no_folder_can_be_written_each_process_compiles_anew(tmp_path):
    (tmp_path / f"skipnet-{os.getuid()}").mkdir(mode=0o755)  # open to others
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "TMPDIR": str(tmp_path)}
    found = run_anew(ROOT.parent, **nowhere)
    assert found == "[1.0, 2.0, 0.0] [3.0, 5.0, 0.0]"


def test_machine_code_that_was_installed_is_run_and_only_read(tmp_path):
    shutil.copytree(ROOT, tmp_path / "skipnet", ignore=shutil.ignore_patterns("__pycache__"))
    installed, kept = tmp_path / "skipnet" / "machine_code", tmp_path / "kept"
    installed.mkdir()
    places = {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(kept)}
    building = {"NUMBA_CACHE_LOCATOR_CLASSES": "skipnet.compiled.InstalledLocator"}
    right = run_anew(tmp_path, **places, **building)  # as when a wheel is built
    before = {path: path.read_bytes() for path in installed.rglob("*.nb?")}
    assert len(before) == 2
    for path in (tmp_path / "skipnet").rglob("*.py"):
        os.utime(path, (1e9, 1e9))  # pip does not keep the times of files
    assert run_anew(tmp_path, **places) == right and not list(kept.rglob("*.nb?"))

    for path in before:  # cut off
        path.write_bytes(before[path][:100])
    assert run_anew(tmp_path, **places) == right and len(list(kept.rglob("*.nb?"))) == 2
    for path in before:
        path.write_bytes(before[path])
    path = tmp_path / "skipnet" / "clouds" / "statistics.py"
    path.write_text(path.read_text().replace("return low_m, high_m", "return high_m, low_m"))
    assert run_anew(tmp_path, **places) == "[3.0, 5.0, 0.0] [1.0, 2.0, 0.0]"
    assert {path: path.read_bytes() for path in installed.rglob("*.nb?")} == before


def test_code_kept_from_an_earlier_version_of_a_file_is_not_used(tmp_path):
    shutil.copytree(ROOT, tmp_path / "skipnet", ignore=shutil.ignore_patterns("__pycache__"))
    before = run_anew(tmp_path, PYTHONPATH=str(tmp_path))
    assert before == "[1.0, 2.0, 0.0] [3.0, 5.0, 0.0]"
    path = tmp_path / "skipnet" / "clouds" / "statistics.py"
    path.write_text(path.read_text().replace("return low_m, high_m", "return high_m, low_m"))
    after = run_anew(tmp_path, PYTHONPATH=str(tmp_path))
    assert after == "[3.0, 5.0, 0.0] [1.0, 2.0, 0.0]"
