"""The plot of ``benchmark=speed``: time and memory against points, log-log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.reporting.tables import PAPER_TABLE_2
from skipnet.viz.colours import scan_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPER_MAP_S = PAPER_TABLE_2["skipnet", "coarse"]["map_s"]
"""What voxels and map alone took in the paper."""
MEMORY_LIMIT = 1.5
"""Peak memory beyond the input, as a multiple of the input, that is drawn for comparison."""
_REFERENCE: dict[str, Any] = {"color": "0.4", "linestyle": "--", "linewidth": 1}


def draw_growth(
    config: EvaluateConfig,
    rows: Sequence[dict[str, Any]],
    exponents: Mapping[str, Mapping[str, float]],
    labels: Mapping[str, str],
) -> Figure:
    """A column per family: times above, every method a line with its exponent, memory below.

    Args:
        config: of the run.
        rows: ``speed_report.summarise`` of what was measured.
        exponents: of each family and method.
        labels: of the methods.
    """
    from matplotlib.figure import Figure

    families, lines = config.speed.families, 1 + config.speed.memory
    figure = Figure(figsize=(5.2 * len(families) + 1, 4.4 * lines), layout="constrained")
    grid = figure.subplots(lines, len(families), squeeze=False, sharey="row")
    for column, family in enumerate(families):
        for index, (method, label) in enumerate(labels.items()):
            same = [row for row in rows if (row["family"], row["method"]) == (family, method)]
            slope = exponents.get(family, {}).get(method)
            name = label if slope is None else f"{label}, exponent {slope:.2f}"
            _draw_times(grid[0, column], same, name, scan_colour(index))
            if config.speed.memory:
                _draw_memory(grid[1, column], same, label, scan_colour(index))
        paper = f"voxels and map in the paper, {PAPER_MAP_S:.1f} s"
        grid[0, column].axhline(PAPER_MAP_S, label=paper, **_REFERENCE)
        grid[0, column].set(title=family, ylabel="time (s)")
        if config.speed.memory:
            of_family = [row for row in rows if row["family"] == family]
            _draw_memory_limit(grid[1, column], of_family)
            grid[1, column].set(ylabel="peak memory beyond the scans (MB)")
    for axes in grid.ravel():
        axes.set(xlabel="points per scan", xscale="log", yscale="log")
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize="small", loc="upper left")
    for axes in grid[:, 0]:  # those of a row share their axis
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** 0.5)  # room for the legend above the lines
    return figure


def _draw_times(axes: Axes, rows: Sequence[dict[str, Any]], label: str, colour: str) -> None:
    """Medians, with bars from the fastest to the slowest pair."""
    points, time_s = ([row[key] for row in rows] for key in ("points_per_scan", "time_s"))
    spread_s = [
        [row["time_s"] - row["fastest_s"] for row in rows],
        [row["slowest_s"] - row["time_s"] for row in rows],
    ]
    axes.errorbar(points, time_s, spread_s, fmt="o-", capsize=2, color=colour, label=label)


def _draw_memory(axes: Axes, rows: Sequence[dict[str, Any]], label: str, colour: str) -> None:
    """Where it was measured, and was more than nothing."""
    known = [row for row in rows if row["extra_bytes"]]
    points = [row["points_per_scan"] for row in known]
    axes.plot(points, [row["extra_bytes"] / 1e6 for row in known], "o-", color=colour, label=label)


def _draw_memory_limit(axes: Axes, rows: Sequence[dict[str, Any]]) -> None:
    """The line at ``MEMORY_LIMIT`` times the input."""
    limits = sorted({(r["points_per_scan"], MEMORY_LIMIT * r["input_bytes"] / 1e6) for r in rows})
    label = f"{MEMORY_LIMIT} times the scans' own"
    axes.plot(*zip(*limits, strict=True), label=label, **_REFERENCE)
