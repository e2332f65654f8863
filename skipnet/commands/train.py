"""Train the network, classes and descriptor, or one for the classes alone: ``skipnet train``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skipnet.commands import hydra_app
from skipnet.progress import tell
from skipnet.training.options import NetworkKind, TrainConfig


def train(config: TrainConfig) -> dict[str, Any]:
    """Run the experiment that ``config`` describes, print its table and return its summary."""
    tell("loading PyTorch")
    if config.network is NetworkKind.two_heads:
        from skipnet.training.experiments.both_heads import train_both_heads as run_experiment
    elif config.network is NetworkKind.deep:
        from skipnet.training.experiments.deep_descriptor import train_deep as run_experiment
    elif config.network is NetworkKind.matcher:
        from skipnet.training.experiments.matching import train_matcher as run_experiment
    else:
        from skipnet.training.experiments.classes_alone import run_experiment

    summary = run_experiment(config)
    print((Path(config.output_dir) / "scores.md").read_text())
    print(f"{summary['reached']['stop_reason']}; everything is in {config.output_dir}")
    return summary


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: its exit code."""
    return hydra_app.run("train", TrainConfig, train, arguments=arguments)
