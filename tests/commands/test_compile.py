"""``skipnet compile``: what it takes; that nothing is left to compile, test_wheel.py checks."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import numpy as np

from skipnet.commands import compile as command
from skipnet.commands.main import main


def test_it_takes_no_arguments_and_says_so(capsys):
    assert main(["compile", "--help"]) == 0
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().out
    assert main(["compile", "fast"]) == 2
    assert capsys.readouterr().err == "compile: takes no 'fast'\n"


def test_it_registers_every_kind_in_both_precisions(capsys, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "skipnet.registration.pipeline.register",
        lambda source_m, target_m, **options: seen.append((source_m, target_m)) or Mock(),
    )
    monkeypatch.setattr(command, "_doubt", lambda result: None)
    monkeypatch.setattr("skipnet.results.skipmaps.skipmaps_of", lambda result: None)
    monkeypatch.setattr("skipnet.viz.pictures.draw_before_after", Mock())
    assert main(["compile"]) == 0
    assert capsys.readouterr().out.startswith("compiled what registering two scans needs")
    kinds = {(source_m.dtype, target_m.dtype) for source_m, target_m in seen}
    assert kinds == {(np.dtype(kind),) * 2 for kind in (np.float32, np.float64)}
    low_m, high_m = command.ROOM_M
    for points_m in (points_m for pair in seen for points_m in pair):
        extent_m = np.ptp(points_m, axis=0)
        assert np.isfinite(points_m).all()
        assert (extent_m <= np.subtract(high_m, low_m) + 1e-4).all() and extent_m.min() > 1


def test_it_runs_with_what_a_wheel_is_built_with():
    """Without those dependencies that ``building/backend.py`` does not ask for."""
    root = Path(__file__).parents[2]
    needed = re.findall(r"^NEEDED = (.*)", (root / "building" / "backend.py").read_text(), re.M)[0]
    block = re.search(
        r"^dependencies = \[(.*?)^\]", (root / "pyproject.toml").read_text(), re.M | re.S
    )
    others = set(re.findall(r'^    "([\w-]+)', block[1], re.M)) - set(
        re.findall(r'"(\w+)"', needed)
    )
    assert {"torch", "open3d", "matplotlib", "hydra-core"} <= others
    imported_as = {"hydra-core": "hydra", "scikit-learn": "sklearn"}
    missing = {imported_as.get(name, name): None for name in others}
    script = f"import sys; sys.modules |= {missing}; from skipnet.commands.compile import *"
    subprocess.run([sys.executable, "-c", f"{script}; compile_usual()"], cwd=root, check=True)
