"""The rooms import only downwards, and ``import skipnet`` stays light."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import skipnet

ROOT = Path(__file__).parents[1]


def test_the_import_contract_holds():
    pytest.importorskip("importlinter", reason="pip install -e '.[test]'")
    from importlinter.cli import lint_imports

    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_a_forbidden_import_would_be_noticed(tmp_path):
    """The contract itself is tested: a copy of the project with one upward import must break it."""
    import shutil

    shutil.copytree(
        ROOT / "skipnet", tmp_path / "skipnet", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    with open(tmp_path / "skipnet" / "geometry.py", "a") as file:
        file.write("\nimport skipnet.clouds.formats\n")
    script = (
        "from importlinter.cli import lint_imports; raise SystemExit(lint_imports(no_cache=True))"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1
    assert "skipnet.geometry is not allowed to import skipnet.clouds" in run.stdout


def test_importing_skipnet_loads_nothing_heavy():
    script = "import sys, skipnet; print(' '.join(sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert not {"numpy", "torch", "open3d", "scipy", "matplotlib"} & set(run.stdout.split())


def test_the_public_names_resolve():
    from skipnet.registration.pipeline import register
    from skipnet.registration.result import Registration

    assert skipnet.register is register
    assert skipnet.Registration is Registration
    with pytest.raises(AttributeError, match="no attribute 'regsiter'"):
        _ = skipnet.regsiter
