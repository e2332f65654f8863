"""The report's curves over all pairs: success by overlap, time by points, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skipnet.benchmark.reporting.comparison import confidences, overlap_curve
from skipnet.benchmark.reporting.tables import final_rows
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.viz.colours import SCAN_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METHOD_COLOURS = (*SCAN_COLOURS, "#999933", "#882255", "#117733", "#88CCEE", "#AA4499")
"""One per method, in the order of the run: Okabe and Ito's, then some of Tol's."""
MARKERS = "osD^vP*X<>hd"
CONFIDENCE_BINS = 10
MOST_WITH_BARS = 4
"""Methods whose intervals can be told apart."""


def draw_overlap(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Figure:
    """Success rate of each method over bins of the overlap, a little apart so that none hides."""
    figure, axes = new_figure(4.2)
    methods = list(dict.fromkeys(row.method for row in rows))
    for index, method in enumerate(methods):
        points = np.array(overlap_curve(final_rows(rows, method)))
        x = points[:, 0] + 0.006 * (index - (len(methods) - 1) / 2)
        reach = np.abs(points[:, 2:].T - points[:, 1]) if len(methods) <= MOST_WITH_BARS else None
        colour = METHOD_COLOURS[index % len(METHOD_COLOURS)]
        axes.errorbar(
            x,
            points[:, 1],
            reach,
            color=colour,
            marker=MARKERS[index % len(MARKERS)],
            markersize=5,
            linewidth=1.5,
            elinewidth=0.6,
            label=labels[method],
        )
    axes.set(xlabel="overlap", ylabel="success rate", xlim=(0, None), ylim=(-0.03, 1.03))
    legend_beside(axes)
    return figure


def draw_points(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Figure:
    """Time of each call against the points of both scans."""
    figure, axes = new_figure(4.2)
    for index, method in enumerate(dict.fromkeys(row.method for row in rows)):
        final = final_rows(rows, method)
        points = np.array([row.source_points + row.target_points for row in final])
        total_s = np.array([row.total_s for row in final])
        broke = np.array([bool(row.error) for row in final])
        colour = METHOD_COLOURS[index % len(METHOD_COLOURS)]
        marker = MARKERS[index % len(MARKERS)]
        axes.scatter(
            points[~broke], total_s[~broke], s=16, marker=marker, color=colour, label=labels[method]
        )
        axes.scatter(points[broke], total_s[broke], s=20, marker="x", color=colour)
    many = [row.source_points + row.target_points for row in rows]
    scale = "log" if max(many) > 3 * min(many) else "linear"
    axes.set(xscale=scale, yscale="log", xlabel="points of both scans", ylabel="time (s)")
    legend_beside(axes)
    return figure


def draw_confidence(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Figure | None:
    """Reliability diagram and precision-recall curve; None if no method says how sure it is."""
    from matplotlib.figure import Figure

    said = {
        method: confidences(final_rows(rows, method))
        for method in dict.fromkeys(row.method for row in rows)
    }
    said = {method: both for method, both in said.items() if len(both[0])}
    if not said:
        return None
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    reliability, recall = figure.subplots(1, 2)
    for index, (method, (confidence, right)) in enumerate(said.items()):
        colour = METHOD_COLOURS[index % len(METHOD_COLOURS)]
        _draw_reliability(reliability, confidence, right, colour, len(said) == 1)
        _draw_precision(recall, confidence, right, colour, labels[method])
    reliability.plot([0, 1], [0, 1], color="#999999", linestyle=":", zorder=0)
    reliability.set(xlabel="confidence", ylabel="share of right answers")
    recall.set(xlabel="recall", ylabel="precision")
    recall.legend(frameon=False, loc="lower left")
    for axes in (reliability, recall):
        axes.set(xlim=(0, 1.03), ylim=(0, 1.06))
        _tidy(axes)
    return figure


def _draw_reliability(
    axes: Axes, confidence: np.ndarray, right: np.ndarray, colour: str, with_counts: bool
) -> None:
    place = np.minimum((confidence * CONFIDENCE_BINS).astype(int), CONFIDENCE_BINS - 1)
    count = np.bincount(place, minlength=CONFIDENCE_BINS)
    used = count > 0
    mean = np.bincount(place, confidence, CONFIDENCE_BINS)[used] / count[used]
    share = np.bincount(place, right, CONFIDENCE_BINS)[used] / count[used]
    axes.plot(mean, share, color=colour, marker="o", linewidth=1.5)
    if with_counts:
        for x, y, size in zip(mean, share, count[used], strict=True):
            axes.annotate(f"{size}", (x, y), (0, 6), textcoords="offset points", ha="center")


def _draw_precision(
    axes: Axes, confidence: np.ndarray, right: np.ndarray, colour: str, label: str
) -> None:
    from sklearn.metrics import precision_recall_curve

    if right.any():
        precision, recall, _ = precision_recall_curve(right, confidence)
        axes.step(recall, precision, where="post", color=colour, linewidth=2, label=label)


def new_figure(height_inch: float) -> tuple[Figure, Axes]:
    """A figure as wide as the report, made without pyplot: nothing global, nothing to close."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, height_inch), layout="constrained")
    axes = figure.subplots()
    _tidy(axes)
    return figure, axes


def legend_beside(axes: Axes) -> None:
    """The legend to the right of the axes, where it hides nothing."""
    axes.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
