"""A toy script: what reaches its task, and that every user error is one line and exit code 2."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from skipnet.benchmark.options import EvaluateConfig
from skipnet.checks import require
from skipnet.commands import hydra_app as command
from skipnet.commands.register import RegisterConfig
from skipnet.training.options import TrainConfig

CONFIGS = Path(__file__).parents[2] / "configs"


class Colour(Enum):
    red = "red"
    blue = "blue"


@dataclass
class Brush:
    width_m: float = 0.1
    colour: Colour = Colour.red

    def __post_init__(self) -> None:
        require(self.width_m > 0, "brush.width_m", self.width_m, "metres above 0")


@dataclass
class ToyConfig:
    title: str = "toy"
    count: int = 3
    output_dir: str = "../out"
    brush: Brush = field(default_factory=Brush)
    extras: dict[str, Any] = field(default_factory=dict)
    style: Any = None


YAML = """
defaults:
  - toy_schema
  - style: plain
  - override hydra/job_logging: disabled
  - override hydra/hydra_logging: disabled
  - _self_
hydra:
  output_subdir: null
  run: {dir: .}
  sweep: {dir: "${output_dir}", subdir: "${hydra.job.num}"}
"""


@pytest.fixture
def toy(tmp_path, monkeypatch, capsys):
    """Runs the toy script; returns its exit code, the configs its task saw, and stderr."""
    configs = tmp_path / "configs"
    (configs / "style").mkdir(parents=True)
    (configs / "toy.yaml").write_text(YAML)
    for style in ("plain", "bold"):
        (configs / "style" / f"{style}.yaml").write_text(f"name: {style}\n")
    stand = tmp_path / "stand"
    stand.mkdir()
    monkeypatch.chdir(stand)
    monkeypatch.delenv(command.FULL_ERROR, raising=False)

    def run(*arguments, task=lambda config: None, **options):
        seen = []

        def spy(config):
            seen.append(config)
            return task(config)

        code = command.run(
            "toy", ToyConfig, spy, config_dir=configs, arguments=arguments, **options
        )
        assert list(stand.iterdir()) == []
        return code, seen, capsys.readouterr().err

    return run


def test_the_task_gets_the_dataclass_with_the_overrides(toy):
    overrides = (
        "count=5",
        "brush.width_m=0.5",
        "brush.colour=blue",
        "+extras.a=[1,2]",
        "style=bold",
    )
    code, [config], error = toy(*overrides)
    assert (code, error) == (0, "")
    assert config == ToyConfig(
        "toy", 5, "../out", Brush(0.5, Colour.blue), {"a": [1, 2]}, {"name": "bold"}
    )


def test_without_overrides_the_defaults_hold(toy):
    _, [config], _ = toy()
    assert config == ToyConfig(style={"name": "plain"})


def test_the_exit_code_is_what_the_result_means(toy):
    code, _, _ = toy(task=lambda config: config.count, exit_code=lambda result: result + 4)
    assert code == 7


def test_a_sweep_runs_every_combination_each_in_its_own_folder(toy, tmp_path):
    code, seen, _ = toy("--multirun", "count=1,2", "brush.colour=red,blue")
    assert code == 0
    assert [(config.count, config.brush.colour.name) for config in seen] == [
        (1, "red"),
        (1, "blue"),
        (2, "red"),
        (2, "blue"),
    ]
    assert [Path(config.output_dir) for config in seen] == [
        tmp_path / "out" / number for number in "0123"
    ]


BAD_OVERRIDES = {
    "cuont=5": "no such option: cuont; did you mean count?",
    "+cuont=5": "no such option: cuont; did you mean count?",
    "++cuont=5": "did you mean count?",
    "brush.widht_m=1": "did you mean brush.width_m?",
    "+brush.hue=1": "no such option: brush.hue",
    "width_m=1": "did you mean brush.width_m?",
    "zzz=1": "the options are title, count, output_dir, brush, extras",
    "~count": "cannot be removed",
    "count": "write option=value",
    "count=a(b": "needs quotes",
    "count=many": "could not be converted to Integer",
    "count=1,2": "--multirun",
    "brush.colour=green": "green",
    "brush.width_m=-1": "brush.width_m=-1.0: expected metres above 0",
    "style=bald": "bold",
    "hydra.nothing=1": "hydra.nothing",
}


@pytest.mark.parametrize("override", BAD_OVERRIDES)
def test_bad_overrides_are_one_line(toy, override):
    code, seen, error = toy(override)
    assert code == command.EXIT_BAD_INPUT == 2
    assert seen == []
    assert error.startswith("toy: ") and error.count("\n") == 1 and error.endswith("\n")
    assert BAD_OVERRIDES[override] in error


def raising(error):
    def task(config):
        raise error

    return task


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("source: too few\n  points"), "toy: source: too few points\n"),
        (FileNotFoundError("a.ply: no such file"), "toy: a.ply: no such file\n"),
        (PermissionError(13, "Permission denied", "out/x"), "toy: out/x: Permission denied\n"),
        (ModuleNotFoundError("pip install x"), "toy: pip install x\n"),
        (
            OSError("libusb-1.0.so.0: cannot open shared object file"),
            "toy: libusb-1.0.so.0: cannot open shared object file; "
            "on Debian: apt-get install libusb-1.0-0 libgl1 libegl1 libgomp1\n",
        ),
    ],
)
def test_the_task_s_user_errors_are_one_line(toy, error, line):
    code, _, printed = toy(task=raising(error))
    assert (code, printed) == (2, line)


@pytest.mark.parametrize(
    "bug", [ZeroDivisionError(), ImportError("no such room", name="skipnet.attic")]
)
def test_a_bug_keeps_its_traceback(toy, bug):
    with pytest.raises(type(bug)):
        toy(task=raising(bug))


def test_hydra_full_error_brings_the_traceback(toy, monkeypatch):
    monkeypatch.setenv(command.FULL_ERROR, "1")
    with pytest.raises(ValueError, match="mine"):
        toy(task=raising(ValueError("mine")))


def test_a_failing_sweep_exits_with_2(toy):
    code, _, error = toy("--multirun", "count=1,2", task=raising(ValueError("mine")))
    assert code == 2
    assert error.endswith("toy: mine\n")


def test_a_preset_that_does_not_exist_names_those_that_do(toy):
    assert "style=bald; choose from bold, plain\n" in toy("style=bald")[2]
    assert "style=bald; choose from bold, plain\n" in toy("--multirun", "style=plain,bald")[2]


@pytest.mark.parametrize("name", ["register", "evaluate", "train"])
def test_help_is_what_hydra_itself_answers(name, capsys):
    schema = {"register": RegisterConfig, "evaluate": EvaluateConfig, "train": TrainConfig}[name]
    arguments = ["seed=5", "--help"]

    def task(config):
        raise AssertionError("help runs nothing")

    code = command.run(name, schema, task, arguments=arguments)
    ours = capsys.readouterr().out
    with pytest.raises(SystemExit):
        command._run_hydra(name, schema, task, CONFIGS, lambda result: 0, arguments, None)
    assert code == 0 and "seed: 5" in ours and ours == capsys.readouterr().out
