"""What ``benchmark=speed`` leaves for people: tables, exponents, ratios, the log-log plot."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.reporting.pages import Report, ReportFigure, run_versions
from skipnet.benchmark.reporting.speed_figures import draw_growth
from skipnet.storage import replacing
from skipnet.viz.dashboard import log_png, log_scalars, open_dashboard
from skipnet.viz.tables import NOTHING, Table, number

if TYPE_CHECKING:
    from skipnet.benchmark.scoring.measurement import Measurement

LARGEST_SIZES = 3
"""What grows with the points shows at the largest sizes; at the small ones all else outweighs it.
"""


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
            _times_table(family, seen, labels),
            _ratio_table(family, seen, labels),
            _exponent_table(family, summary, labels),
            _stages_table(family, seen),
        ]
        if config.speed.memory:
            tables.append(_memory_table(family, seen, labels))
    if config.speed.kinds:
        tables.append(_kinds_table(config.speed.kinds, measured, labels))
        tables += [
            _stages_table(kind, [found for found in measured if found.family == kind])
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


def summarise(measured: Sequence[Measurement]) -> list[dict[str, Any]]:
    """One entry per family, size and method: medians over the pairs, successes among them."""
    rows = []
    for family, size, method in dict.fromkeys((m.family, m.size, m.method) for m in measured):
        same = [m for m in measured if (m.family, m.size, m.method) == (family, size, method)]
        extra = [m.extra_bytes for m in same if m.extra_bytes is not None]
        stages = dict.fromkeys(stage for m in same for stage in m.stages_s)
        rows.append(
            {
                "family": family,
                "size": size,
                "method": method,
                "pairs": len(same),
                "successes": sum(m.is_right for m in same),
                "points_per_scan": _median(m.points / 2 for m in same),
                "time_s": _median(m.time_s for m in same),
                "fastest_s": min(m.time_s for m in same),
                "slowest_s": max(m.time_s for m in same),
                "stages_s": {s: _median(m.stages_s.get(s, 0.0) for m in same) for s in stages},
                "input_bytes": same[0].input_bytes,
                "extra_bytes": extra[0] if extra else None,
            }
        )
    return rows


def exponents(
    measured: Sequence[Measurement], sizes: int | None = None
) -> dict[str, dict[str, float]]:
    """Of each family and method: b of the fit time = a * points^b, where it met two sizes or more.

    Args:
        measured: in order of size.
        sizes: fit to so many of a method's largest sizes; None takes all.
    """
    found: dict[str, dict[str, float]] = {}
    rows = summarise(measured)
    for family, method in dict.fromkeys((row["family"], row["method"]) for row in rows):
        same = [row for row in rows if (row["family"], row["method"]) == (family, method)]
        same = same[-sizes:] if sizes else same
        if len(same) > 1:
            points, time_s = (
                np.log([row[key] for row in same]) for key in ("points_per_scan", "time_s")
            )
            found.setdefault(family, {})[method] = float(np.polyfit(points, time_s, 1)[0])
    return found


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


def _times_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    def cell(row: dict[str, Any]) -> str:
        """Time and successes of one method at one size."""
        return f"{number(row['time_s'])} ({row['successes']}/{row['pairs']})"

    note = "Median seconds, and how many poses are right. – : above the method's limit of points."
    return _by_size(f"Time, {family}", seen, labels, cell, note)


def _ratio_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    """How many times as long as the first method the others take."""
    first = next(iter(labels))
    own_s = {row["size"]: row["time_s"] for row in summarise(seen) if row["method"] == first}

    def cell(row: dict[str, Any]) -> str:
        """Ratio of the medians of one method and of the first at one size."""
        return number(row["time_s"] / own_s[row["size"]]) if row["size"] in own_s else NOTHING

    title = f"Time as a multiple of that of {labels[first]}, {family}"
    return _by_size(title, seen, labels, cell, "")


def _exponent_table(family: str, summary: dict[str, Any], labels: dict[str, str]) -> Table:
    """How the time grows, in all and where the points outweigh what does not grow with them."""
    fits = [summary[key].get(family, {}) for key in ("exponents", "exponents_of_largest")]
    lines = tuple(
        (label, *(f"{fit[name]:.2f}" if name in fit else NOTHING for fit in fits))
        for name, label in labels.items()
    )
    headers = ("b of time = a points^b", "all sizes", f"its {LARGEST_SIZES} largest")
    return Table(f"Growth, {family}", headers, lines)


def _kinds_table(
    kinds: Sequence[str], measured: Sequence[Measurement], labels: dict[str, str]
) -> Table:
    """Time of each method on each kind of hard pair."""
    of = {(row["family"], row["method"]): row for row in summarise(measured)}

    def cell(row: dict[str, Any]) -> str:
        """Time and successes of one method on one kind."""
        return f"{number(row['time_s'])} ({row['successes']}/{row['pairs']})"

    lines = tuple(
        (
            kind,
            f"{of[kind, next(iter(labels))]['points_per_scan']:,.0f}",
            *(cell(of[kind, name]) for name in labels),
        )
        for kind in kinds
    )
    note = (
        "Median seconds, and how many answers are right: where the scans share nothing, that no "
        "pose is called registered."
    )
    headers = ("kind of pair", "points per scan", *labels.values())
    return Table("Time, hard pairs", headers, lines, note)


def _memory_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    def cell(row: dict[str, Any]) -> str:
        """Extra memory of one method at one size, beside the input's."""
        extra = row["extra_bytes"]
        if extra is None:
            return NOTHING
        return f"{extra / 1e6:.0f} MB ({number(extra / row['input_bytes'])} x input)"

    note = "Peak of resident memory beyond the two scans, each time in a process of its own."
    return _by_size(f"Peak memory, {family}", seen, labels, cell, note)


def _by_size(
    title: str,
    seen: Sequence[Measurement],
    labels: dict[str, str],
    cell: Callable[[dict[str, Any]], str],
    note: str,
) -> Table:
    """A line per method, a column per size."""
    of = {(row["method"], row["size"]): cell(row) for row in summarise(seen)}
    sizes = sorted({size for _, size in of})
    lines = tuple(
        (label, *(of.get((name, size), NOTHING) for size in sizes))
        for name, label in labels.items()
    )
    return Table(title, ("points per scan", *(f"{size:,}" for size in sizes)), lines, note)


def _stages_table(family: str, seen: Sequence[Measurement]) -> Table:
    """The first method's own stages at every size."""
    rows = [row for row in summarise(seen) if row["method"] == seen[0].method]
    stages = dict.fromkeys(stage for row in rows for stage in row["stages_s"])
    lines = tuple(
        (stage, *(number(row["stages_s"].get(stage, 0.0)) for row in rows)) for stage in stages
    )
    headers = ("stage (s)", *(f"{row['points_per_scan']:,.0f}" for row in rows))
    return Table(f"Stages of {seen[0].method}, {family}", headers, lines)


def _median(values: Any) -> float:
    return float(np.median(list(values)))


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(f"{value:,}" for value in numbers)
