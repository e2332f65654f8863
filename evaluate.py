"""Compare registration methods on the same pairs: ``python evaluate.py --help``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from skipnet import command
from skipnet.config import EvaluateConfig

CONFIG_DIR = Path(__file__).parent / "configs"


def main(config: EvaluateConfig) -> dict[str, Any]:
    """Run the benchmark that ``config`` describes and return its summary."""
    if config.benchmark == "speed":
        from skipnet.benchmark.speed import run_speed

        return run_speed(config)
    from skipnet.benchmark.runner import run_benchmark

    return run_benchmark(config)


if __name__ == "__main__":
    sys.exit(command.run("evaluate", EvaluateConfig, main, CONFIG_DIR))
