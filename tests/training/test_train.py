"""train.py from the command line to the files of a run, on as little data as will do."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
import yaml

from skipnet.commands.hydra_app import CONFIG_DIR
from skipnet.commands.train import main
from skipnet.training.options import TrainConfig

SMALL = [
    "experiment=classes",
    "data.training_scenes=2",
    "data.validation_scenes=1",
    "data.test_scenes=1",
]
SMALL += ["data.families=[closed]", "data.workers=1", "data.most_per_class=25"]


def train(*arguments: str) -> int:
    return main(arguments)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    assert train(*SMALL, "epochs=3", "compare_sklearn=true", f"output_dir={folder}") == 0
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
    scenes = ["data.training_scenes=8", "data.test_scenes=1"]
    assert train("experiment=paper", *scenes, f"output_dir={tmp_path}") == 0
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


@pytest.mark.parametrize("name", ["adam", "adamw", "sgd", "rmsprop", "lbfgs", "scg"])
def test_every_optimiser_config_makes_its_optimiser(name: str) -> None:
    from hydra import compose, initialize_config_dir
    from hydra.core.config_store import ConfigStore
    from hydra.utils import instantiate

    ConfigStore.instance().store(name="train_schema", node=TrainConfig)
    with initialize_config_dir(str(CONFIG_DIR.resolve()), version_base="1.3"):
        config = compose("train", [f"optimizer={name}", "learning_rate=0.02"])
    weights = [torch.zeros(3, dtype=torch.float64, requires_grad=True)]
    optimizer = instantiate(config.optimizer)(weights)
    known = {"scg": "ScaledConjugateGradient"}.get(name, name)
    assert type(optimizer).__name__.lower() == known.lower()
    assert name == "scg" or optimizer.param_groups[0]["lr"] == 0.02


@pytest.mark.parametrize("group", ["sampling", "loss"])
def test_every_choice_of_a_group_is_a_configuration(group: str) -> None:
    from hydra import compose, initialize_config_dir
    from hydra.core.config_store import ConfigStore

    ConfigStore.instance().store(name="train_schema", node=TrainConfig)
    choices = sorted(file.stem for file in (CONFIG_DIR / group).glob("*.yaml"))
    with initialize_config_dir(str(CONFIG_DIR.resolve()), version_base="1.3"):
        configs = [compose("train", [f"{group}={choice}"]) for choice in choices]
        assert compose("train") in configs  # the default is one of them
    assert len(choices) == 2 and configs[0] != configs[1]


def test_a_sweep_writes_one_folder_per_run(tmp_path: Path) -> None:
    assert train("--multirun", *SMALL, "epochs=1", "seed=0,1", f"output_dir={tmp_path}") == 0
    seeds = [json.loads(p.read_text())["seed"] for p in sorted(tmp_path.glob("*/summary.json"))]
    assert seeds == [0, 1]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("device=cuda", "device=cuda: torch"),
        ("data.scanner=nosuch", "unknown scanner 'nosuch'"),
        ("data.patch=axis_aligned", "surface_frame, or network=classes"),
        ("data.samples=500", "null, or network=classes"),
        ("compare_sklearn=true", "false, or network=classes"),
        ("optimizer=scg", "one for mini-batches, or network=classes"),
        ("+optimizer.nosuch=1", "nosuch"),
        ("optimizer._target_=os.system", "expected an optimiser of torch.optim.NAME or"),
        ("optimizer._target_=torch.optim.lr_scheduler.torch.load", "expected an optimiser of"),
        ("epoch=3", "did you mean epochs?"),
        ("epochs=0", "epochs=0: expected 1 or more"),
        ("data.families=[]", "at least one family"),
        ("data.families=[papre_room]", "paper_room"),
        ("descriptor.families=[teraain]", "terrain"),
        ("data.training_scenes=2000", "1 to 1000"),
        ("hidden_sizes=[50]", "two sizes, or network=classes"),
        ("activation=tanh", "gelu, or network=classes"),
        ("descriptor.hidden_dropout=1", "0 or more and below 1"),
    ],
)
def test_bad_options_are_one_line_and_exit_code_2(
    override: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if override == "device=cuda" and torch.cuda.is_available():
        pytest.skip("the device is there")
    assert train(override, "data.workers=1", f"output_dir={tmp_path}") == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
