"""train.py from the command line to the files of a run, on as little data as will do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SMALL = ["data.training_scenes=2", "data.validation_scenes=1", "data.test_scenes=1"]
SMALL += ["data.families=[closed]", "data.workers=1", "data.most_per_class=25"]


def train(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(ROOT / "train.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    result = train(*SMALL, "epochs=3", "compare_sklearn=true", f"output_dir={folder}")
    assert result.returncode == 0, result.stderr
    assert "| network | all |" in result.stdout
    return folder


def test_a_run_writes_all_it_promises(run: Path) -> None:
    for name in ("config.yaml", "classifier.pt", "classifier.json", "scores.csv", "scores.md"):
        assert (run / name).stat().st_size > 0, name
    assert (run / "figures" / "confusion.png").read_bytes().startswith(b"\x89PNG")
    config = yaml.safe_load((run / "config.yaml").read_text())
    assert config["data"]["patch"] == "surface_frame"
    assert config["epochs"] == 3


def test_the_summary_says_what_was_reached(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert summary["reached"]["stop_reason"] == "all 3 epochs done"
    peers = {"RandomForest", "SVC", "kNN", "HistGradientBoosting"}
    assert set(summary["unseen"]) == {"network", "network, same voxels", *peers}
    for figures in summary["unseen"].values():
        assert 0 < figures["macro_f1"] <= 1


def test_tensorboard_shows_curves_pictures_meshes_and_hyperparameters(run: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"tensors": 0}).Reload()
    tags = events.Tags()
    for scalar in ("loss/training", "loss/validation", "accuracy/validation", "recall/edge"):
        assert len(events.Scalars(scalar)) == 3, scalar
    assert "unseen" in tags["images"]
    meshes = [tag for tag in tags["tensors"] if tag.startswith("skipmap/")]
    shown = {tag.split("/")[1].removesuffix("_VERTEX") for tag in meshes}
    assert {"curvature", "true_class", "network_class"} <= shown
    assert any("_hparams_" in tag for tag in events.summary_metadata)


def test_paper_experiment_is_table_1(tmp_path: Path) -> None:
    result = train("experiment=paper", "data.test_scenes=1", f"output_dir={tmp_path}")
    assert result.returncode == 0, result.stderr
    config = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert config["hidden_sizes"] == [50]
    assert config["optimizer"]["_target_"].endswith("ScaledConjugateGradient")
    assert (config["epochs"], config["goal"], config["learning_rate"]) == (1000, 1e-11, 0.01)
    assert config["data"]["samples"] == 510
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["samples"]["training"] == 357
    assert {"held_out_accuracy", "validation_loss", "stop_reason"} <= set(summary["reached"])
    card = json.loads((tmp_path / "classifier.json").read_text())
    assert (card["hidden_sizes"], card["activation"]) == ([50], "tanh")


@pytest.mark.parametrize("optimizer", ["adam", "sgd", "rmsprop", "lbfgs"])
def test_every_optimiser_config_runs(optimizer: str, tmp_path: Path) -> None:
    batch = "batch_size=null" if optimizer == "lbfgs" else "batch_size=64"
    result = train(*SMALL, "epochs=1", batch, f"optimizer={optimizer}", f"output_dir={tmp_path}")
    assert result.returncode == 0, result.stderr


def test_a_sweep_writes_one_folder_per_run(tmp_path: Path) -> None:
    result = train("--multirun", *SMALL, "epochs=1", "seed=0,1", f"output_dir={tmp_path}")
    assert result.returncode == 0, result.stderr
    seeds = [json.loads(p.read_text())["seed"] for p in sorted(tmp_path.glob("*/summary.json"))]
    assert seeds == [0, 1]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("epoch=3", "did you mean epochs?"),
        ("epochs=0", "epochs=0: expected 1 or more"),
        ("data.families=[]", "at least one family"),
        ("data.families=[papre_room]", "paper_room"),
        ("data.training_scenes=2000", "1 to 1000"),
    ],
)
def test_bad_options_are_one_line_and_exit_code_2(override: str, message: str) -> None:
    result = train(override, "data.workers=1")
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
