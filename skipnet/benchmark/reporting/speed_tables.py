"""The tables of ``benchmark=speed``, and the figures in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.viz.tables import NOTHING, Table, number

if TYPE_CHECKING:
    from skipnet.benchmark.scoring.measurement import Measurement

LARGEST_SIZES = 3
"""What grows with the points shows at the largest sizes; at the small ones all else outweighs it.
"""


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


def times_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    """Time of each method at every size."""

    def cell(row: dict[str, Any]) -> str:
        """Time and successes of one method at one size."""
        return f"{number(row['time_s'])} ({row['successes']}/{row['pairs']})"

    note = "Median seconds, and how many poses are right. – : above the method's limit of points."
    return _by_size(f"Time, {family}", seen, labels, cell, note)


def ratio_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    """How many times as long as the first method the others take."""
    first = next(iter(labels))
    own_s = {row["size"]: row["time_s"] for row in summarise(seen) if row["method"] == first}

    def cell(row: dict[str, Any]) -> str:
        """Ratio of the medians of one method and of the first at one size."""
        return number(row["time_s"] / own_s[row["size"]]) if row["size"] in own_s else NOTHING

    title = f"Time as a multiple of that of {labels[first]}, {family}"
    return _by_size(title, seen, labels, cell, "")


def exponent_table(family: str, summary: dict[str, Any], labels: dict[str, str]) -> Table:
    """How the time grows, in all and where the points outweigh what does not grow with them."""
    fits = [summary[key].get(family, {}) for key in ("exponents", "exponents_of_largest")]
    lines = tuple(
        (label, *(f"{fit[name]:.2f}" if name in fit else NOTHING for fit in fits))
        for name, label in labels.items()
    )
    headers = ("b of time = a points^b", "all sizes", f"its {LARGEST_SIZES} largest")
    return Table(f"Growth, {family}", headers, lines)


def kinds_table(
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


def memory_table(family: str, seen: Sequence[Measurement], labels: dict[str, str]) -> Table:
    """Peak memory of each method at every size."""

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


def stages_table(family: str, seen: Sequence[Measurement]) -> Table:
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
