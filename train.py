"""Train the network, classes and descriptor, or one for the classes alone: ``train.py --help``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from skipnet import command
from skipnet.config import NetworkKind, TrainConfig

CONFIG_DIR = Path(__file__).parent / "configs"


def main(config: TrainConfig) -> dict[str, Any]:
    """Run the experiment that ``config`` describes, print its table and return its summary."""
    if config.network is NetworkKind.two_heads:
        from skipnet.learning.descriptor_experiment import train_both_heads as run_experiment
    else:
        from skipnet.learning.experiment import run_experiment

    summary = run_experiment(config)
    print((Path(config.output_dir) / "scores.md").read_text())
    print(f"{summary['reached']['stop_reason']}; everything is in {config.output_dir}")
    return summary


if __name__ == "__main__":
    sys.exit(command.run("train", TrainConfig, main, CONFIG_DIR))
