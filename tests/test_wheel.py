"""What pip installs works: the wheel in an empty folder, with its own configs and weights."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from skipnet.geometry import pose_error
from skipnet.simulation.scanning.pairs import simulate_pair

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "skipnet"
DATA = ["py.typed", "registration/confidence.json", "viz/viewer.js", "viz/viewer.css"]
DATA += [f"networks/weights/{path.name}" for path in PACKAGE.glob("networks/weights/*.*")]
DATA += [f"configs/{path.relative_to(ROOT / 'configs')}" for path in ROOT.glob("configs/**/*.yaml")]
TRAINING = ["experiment=classes", "data.families=[closed]", "data.workers=1", "epochs=1"]
TRAINING += ["data.training_scenes=1", "data.validation_scenes=1", "data.test_scenes=1"]


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """The wheel and the sdist, built from a copy of what is distributed."""
    pytest.importorskip("setuptools", "77", reason="pip install -e '.[test]'")
    copy = tmp_path_factory.mktemp("source") / "skipnet"
    copy.mkdir()
    skipped = shutil.ignore_patterns("__pycache__")
    for folder in ("skipnet", "configs", "building"):
        shutil.copytree(ROOT / folder, copy / folder, symlinks=True, ignore=skipped)
    for name in ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    build = "from backend import *; build_wheel('dist'); build_sdist('dist')"
    run([sys.executable, "-c", f"import sys; sys.path.insert(0, 'building'); {build}"], copy)
    [wheel], [sdist] = (copy / "dist").glob("*.whl"), (copy / "dist").glob("*.tar.gz")
    return wheel, sdist


@pytest.fixture(scope="module")
def installed(distributions, tmp_path_factory):
    """An environment with the wheel in it; the packages that it needs are lent, not fetched."""
    folder = tmp_path_factory.mktemp("environment")
    run([sys.executable, "-m", "venv", "--without-pip", "."], folder)
    pip = [sys.executable, "-m", "pip", "--python", "bin/python", "install", "--quiet"]
    run([*pip, "--no-deps", "--no-index", str(distributions[0])], folder)
    [packages] = folder.glob("lib/python*/site-packages")
    (packages / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin"


def run(command, folder, **variables):
    """Run a command in a folder that is not the repository; its standard output."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= variables
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_wheel_and_sdist_hold_the_data(distributions):
    wheel, sdist = distributions
    with zipfile.ZipFile(wheel) as archive:
        inside = archive.namelist()
        assert len(DATA) > 20 and [name for name in DATA if f"skipnet/{name}" not in inside] == []
    stem = sdist.name.removesuffix(".tar.gz")
    with tarfile.open(sdist) as archive:
        files = [member.name for member in archive.getmembers() if member.isfile()]
        assert [name for name in DATA if f"{stem}/skipnet/{name}" not in files] == []
        assert not [name for name in files if name.startswith(f"{stem}/tests")]


def test_an_installed_registration_compiles_nothing(installed, distributions, tmp_path):
    [code] = installed.parent.glob("lib/python*/site-packages/skipnet/machine_code")
    before = {path: path.read_bytes() for path in code.rglob("*") if path.is_file()}
    assert len([path for path in before if path.suffix == ".nbc"]) > 40
    pair = simulate_pair("closed", 4, points=15_000).pair
    for name, points_m in (("source", pair.source_m), ("target", pair.target_m)):
        np.save(tmp_path / f"{name}.npy", points_m)
    command = [str(installed / "skipnet"), "register", "source=source.npy", "target=target.npy"]
    kept = tmp_path / "kept"
    kept.mkdir()
    assert run(command, tmp_path, NUMBA_CACHE_DIR=str(kept)).startswith("registered")
    assert not list(kept.rglob("*.nbc"))
    assert {path: path.read_bytes() for path in code.rglob("*") if path.is_file()} == before
    assert distributions[0].name.endswith("-py3-none-any.whl")


def test_a_wheel_is_built_without_machine_code_where_that_is_unwanted_or_fails(tmp_path):
    copy = tmp_path / "source"
    shutil.copytree(ROOT / "building", copy / "building")
    (copy / "skipnet").mkdir()
    (copy / "skipnet" / "__init__.py").write_text("raise ImportError('nothing to compile with')")
    (copy / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text().replace(
        'dynamic = ["version"]', 'version = "1"').replace(
        'version = { attr = "skipnet.provenance.__version__" }', "").replace(
        'readme = "README.md"\n', ""))  # fmt: skip
    build = "import sys; sys.path.insert(0, 'building'); import backend as b; b.build_wheel('.');"
    told = {}
    for wanted in ("yes", "no"):
        ask = f"{build} print(len(b.get_requires_for_build_wheel()))"
        told[wanted] = run([sys.executable, "-c", ask], copy, SKIPNET_MACHINE_CODE=wanted)
        with zipfile.ZipFile(copy / "skipnet-1-py3-none-any.whl") as archive:
            assert not [name for name in archive.namelist() if name.endswith((".nbi", ".nbc"))]
    assert "not compiled ahead of time" in told["yes"] and told["yes"].endswith("\n6\n")
    assert "compiled" not in told["no"] and told["no"].endswith("\n0\n")


def test_the_installed_commands_register_evaluate_and_train(installed, tmp_path):
    python = str(installed / "python")
    where = run([python, "-c", "import skipnet; print(skipnet.__file__)"], tmp_path)
    assert Path(where.strip()).is_relative_to(installed.parent)

    pair = simulate_pair("closed", 5, points=15_000).pair
    for name, points_m in (("source", pair.source_m), ("target", pair.target_m)):
        np.save(tmp_path / f"{name}.npy", points_m)
    command = [str(installed / "skipnet"), "register", "source=source.npy", "target=target.npy"]
    assert run([*command, "output_dir=pair"], tmp_path).startswith("registered")
    result = json.loads((tmp_path / "pair" / "result.json").read_text())
    rotation_rad, translation_m = pose_error(
        np.array(result["T_target_source"]), pair.T_target_source
    )
    assert np.rad2deg(rotation_rad) < 0.5 and translation_m < 0.03

    evaluation = ["benchmark=simulated", "pairs=1", "points=8000", "methods=[skipnet]", "worst=0"]
    with ThreadPoolExecutor() as side_by_side:
        evaluate = [python, "-m", "skipnet", "evaluate", *evaluation, "output_dir=benchmark"]
        train = [str(installed / "skipnet"), "train", *TRAINING, "output_dir=training"]
        list(side_by_side.map(run, (evaluate, train), (tmp_path, tmp_path)))
    summary = json.loads((tmp_path / "benchmark" / "summary.json").read_text())
    assert [row["success_rate"] for row in summary["rows"] if row["stage"] != "coarse"] == [1]
    trained = json.loads((tmp_path / "training" / "summary.json").read_text())
    assert trained["reached"]["stop_reason"] == "all 1 epochs done"
