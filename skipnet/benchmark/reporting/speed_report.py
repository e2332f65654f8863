"""What ``benchmark=speed`` leaves for people: tables, exponents, ratios, the log-log plot."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.reporting.pages import Report, ReportFigure, run_versions
from skipnet.benchmark.reporting.speed_figures import draw_growth
from skipnet.benchmark.reporting.speed_tables import (
    LARGEST_SIZES,
    exponent_table,
    exponents,
    kinds_table,
    memory_table,
    ratio_table,
    stages_table,
    summarise,
    times_table,
)
from skipnet.storage import replacing
from skipnet.viz.dashboard import log_png, log_scalars, open_dashboard
from skipnet.viz.tables import number

if TYPE_CHECKING:
    from skipnet.benchmark.scoring.measurement import Measurement


def write_speed_report(
    config: EvaluateConfig, measured: Sequence[Measurement], folder: Path
) -> dict[str, Any]:
    """Write summary.json, report.md, report.html and figures/; return the summary."""
    labels = {name: method.label or name for name, method in config.methods.items()}
    summary: dict[str, Any] = {
        "about": _about(config),
        "versions": run_versions(),
        "comparison": _ratios(config, measured, labels),
        "rows": summarise(measured),
        "exponents": exponents(measured),
        "exponents_of_largest": exponents(measured, LARGEST_SIZES),
    }
    tables = []
    for family in config.speed.families:
        seen = [found for found in measured if found.family == family]
        tables += [
            times_table(family, seen, labels),
            ratio_table(family, seen, labels),
            exponent_table(family, summary, labels),
            stages_table(family, seen),
        ]
        if config.speed.memory:
            tables.append(memory_table(family, seen, labels))
    if config.speed.kinds:
        tables.append(kinds_table(config.speed.kinds, measured, labels))
        tables += [
            stages_table(kind, [found for found in measured if found.family == kind])
            for kind in config.speed.kinds
        ]
    caption = (
        "Against points per scan, all logarithmic. Above, median time, with bars from the fastest "
        "to the slowest pair; the exponent is the slope of the line fitted to all sizes. Below, "
        "peak memory beyond the two scans."
    )
    figures = []
    if config.speed.families:
        growth = draw_growth(config, summary["rows"], summary["exponents"], labels)
        figures = [ReportFigure("times", caption, growth)]
    title = f"Registration benchmark: {config.benchmark}"
    pictures = Report(title, summary, tables, figures).write(folder)
    _write_scores(summary["rows"], folder / "scores.csv")
    with open_dashboard(folder / "tensorboard") as writer:
        for row in summary["rows"]:
            tag = f"time_s against points per scan, {row['family']}/{row['method']}"
            log_scalars(writer, {tag: row["time_s"]}, row["size"])
        for name, picture in pictures.items():
            log_png(writer, f"figures/{name}", picture)
    return summary


def _write_scores(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """One line per family, size and method, without the stages."""
    columns = [name for name in rows[0] if name != "stages_s"]
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def _about(config: EvaluateConfig) -> dict[str, str]:
    return {
        "benchmark": config.benchmark,
        "methods": ", ".join(config.methods),
        "scans": f"{', '.join(config.speed.families)}; {_listed(config.speed.points)} points each",
        "hard pairs": ", ".join(config.speed.kinds) or "none",
        "pairs": f"{config.pairs} of each size, from scene number {config.seed} on; of each the "
        f"middle one of {config.speed.repeats} runs",
        "limits": ", ".join(f"{m}: {n:,} points" for m, n in config.speed.most_points.items())
        or "none",
    }


def _ratios(
    config: EvaluateConfig, measured: Sequence[Measurement], labels: dict[str, str]
) -> list[str]:
    """How the first method compares with each other one at the largest size both met."""
    rows, (first, *others) = summarise(measured), config.methods
    sentences = []
    for family in config.speed.families:
        of = {(r["method"], r["size"]): r for r in rows if r["family"] == family}
        for name in others:
            both = [b for b in config.speed.points if (first, b) in of and (name, b) in of]
            if both:
                ours, theirs = of[first, both[-1]], of[name, both[-1]]
                times = number(theirs["time_s"] / ours["time_s"])
                size = f"{both[-1]:,} points, {family}"
                sentences.append(f"{size}: {labels[name]} takes {times} times as long as {first}.")
    return sentences


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(f"{value:,}" for value in numbers)
