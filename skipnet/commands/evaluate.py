"""Compare registration methods on the same pairs: ``skipnet evaluate --help``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from skipnet.benchmark.options import EvaluateConfig
from skipnet.commands import hydra_app


def evaluate(config: EvaluateConfig) -> dict[str, Any]:
    """Run the benchmark that ``config`` describes and return its summary."""
    if config.benchmark == "speed":
        from skipnet.benchmark.running.speed import run_speed

        return run_speed(config)
    from skipnet.benchmark.running.runner import run_benchmark

    return run_benchmark(config)


def rows(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """What the table of a sweep says of a run: a row per method and stage."""
    return [
        {
            "method": entry["label"],
            "right": f"{entry['successes']} of {entry['pairs']}",
            "median error (mm)": entry["median"]["mean_error_mm"],
            "median rotation (deg)": entry["median"]["rotation_error_deg"],
            "median time (s)": entry["median"]["time_s"],
        }
        for entry in summary.get("rows", [])
        if "successes" in entry
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: its exit code."""
    return hydra_app.run("evaluate", EvaluateConfig, evaluate, arguments=arguments, as_rows=rows)
