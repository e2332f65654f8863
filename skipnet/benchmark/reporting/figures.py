"""The report's figures: error curves, errors pair by pair, time by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.methods import STAGES
from skipnet.benchmark.reporting.curves import (
    METHOD_COLOURS,
    draw_confidence,
    draw_overlap,
    draw_points,
    legend_beside,
    new_figure,
)
from skipnet.benchmark.reporting.pages import Dots, ReportFigure
from skipnet.benchmark.reporting.pair_views import VIEWED_POINTS, pair_view
from skipnet.benchmark.scoring.predictions import Prediction
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.benchmark.scoring.summary import row_label
from skipnet.geometry import transform_points
from skipnet.types import FloatArray, IntArray, Pair
from skipnet.viz.colours import SOURCE_COLOUR, TARGET_COLOUR
from skipnet.viz.pictures import draw_before_after
from skipnet.viz.views import thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STAGE_COLOURS = {"map": "#56B4E9", "transform": "#E69F00", "fine": "#0072B2"}
STAGE_NAMES = {"map": "voxels and map", "transform": "coarse transform", "fine": "fine match"}
FARTHEST_MM = 1e5
"""A diverged pose, kilometres away, does not set the scale."""
MOST_WITH_COARSE = 4
"""With more methods, curves show their final poses only."""


def draw_figures(
    rows: Sequence[ScoreRow], summary: Sequence[dict[str, Any]], labels: dict[str, str]
) -> list[ReportFigure]:
    """The figures about all pairs, in the order in which a report shows them."""
    return [
        ReportFigure(
            "error_curves",
            "Share of the pairs whose mean axis error is at most x",
            draw_error_curves(rows, labels),
        ),
        ReportFigure(
            "pair_errors",
            "Mean axis error of every pair; hollow: outside the success thresholds",
            draw_pair_errors(rows, labels),
        ),
        ReportFigure("times", "Median time of each stage", draw_times(summary, labels)),
        ReportFigure(
            "overlap",
            "Success by overlap, in the bins of the table; bars: 95 % intervals, for few methods",
            draw_overlap(rows, labels),
        ),
        ReportFigure(
            "points",
            "Time of every call by the size of its two scans; crosses: no answer",
            draw_points(rows, labels),
        ),
        *_confidence_figures(rows, labels),
    ]


def _confidence_figures(rows: Sequence[ScoreRow], labels: dict[str, str]) -> list[ReportFigure]:
    figure = draw_confidence(rows, labels)
    caption = (
        "Confidence: left, the share of right answers by confidence, which lies on the diagonal if "
        "calibrated (numbers: answers in the bin); right, precision against recall"
    )
    return [] if figure is None else [ReportFigure("confidence", caption, figure)]


def draw_extremes(
    method: str,
    rows: Sequence[ScoreRow],
    predictions: Sequence[Prediction],
    pair_set: PairSet,
    worst: int,
) -> list[ReportFigure]:
    """Before and after of the method's typical (median error) and worst pairs with a pose."""
    final = [r for r in rows if (r.method, r.stage) == (method, "fine") and not r.error]
    final.sort(key=lambda row: row.mean_error_mm)
    if not final:
        return []
    pose_of = {p.pair: p.pose("fine") for p in predictions if p.method == method}
    chosen = [("typical", final[len(final) // 2])]
    chosen += [(f"worst_{n}", row) for n, row in enumerate(final[::-1][:worst], start=1)]
    figures = []
    for kind, row in chosen:
        pair, pose = pair_set.load(pair_set.names.index(row.pair)), pose_of[row.pair]
        assert pose is not None  # rows without an error have a pose
        outcome = "right" if row.success else f"wrong, and called {row.status}"
        caption = (
            f"{kind.replace('_', ' ').capitalize()} pair of {method}: {row.pair}, {outcome}; "
            f"{row.rotation_error_deg:.3g} degrees, {row.mean_error_mm:.3g} mm"
        )
        figure = draw_before_after(pair.source_m, pair.target_m, pose)
        figures.append(
            ReportFigure(f"{kind}_pair", caption, figure, pair_view(pair, pose), _dots(pair, pose))
        )
    return figures


def _dots(pair: Pair, T_target_source: FloatArray) -> Dots:
    """Both scans as the method has them, in their colours."""
    moved_m = transform_points(T_target_source, thin(pair.source_m, VIEWED_POINTS // 4))
    fixed_m = thin(pair.target_m, VIEWED_POINTS // 4)
    colours = [np.tile(_rgb(SOURCE_COLOUR), (len(moved_m), 1))]
    colours.append(np.tile(_rgb(TARGET_COLOUR), (len(fixed_m), 1)))
    return Dots(np.concatenate([moved_m, fixed_m]), np.concatenate(colours))


def _rgb(colour: str) -> IntArray:
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.uint8)


def draw_error_curves(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Figure:
    """Cumulative curves of the mean axis error; one that ends below 1 has pairs without a pose."""
    figure, axes = new_figure(4.2)
    for line in _lines(rows, labels):
        errors_mm = np.sort([row.mean_error_mm for row in line.rows])
        shares = np.arange(1, len(errors_mm) + 1) / len(errors_mm)
        finite = np.isfinite(errors_mm)
        x_mm = np.concatenate([errors_mm[finite][:1], errors_mm[finite]])
        y = np.concatenate([[0.0][: finite.sum()], shares[finite]])
        style = "--" if line.is_coarse else "-"
        axes.step(x_mm, y, style, where="post", color=line.colour, label=line.label, linewidth=2)
    axes.set(
        xscale="log", xlabel="mean axis error (mm)", ylabel="share of the pairs", ylim=(0, 1.03)
    )
    axes.set_xlim(right=min(axes.get_xlim()[1], FARTHEST_MM))
    legend_beside(axes)
    return figure


def draw_pair_errors(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Figure:
    """One mark per pair and row; hollow marks are failures."""
    from matplotlib.ticker import MaxNLocator

    figure, axes = new_figure(4.2)
    index_of = {name: i for i, name in enumerate(dict.fromkeys(row.pair for row in rows))}
    for line in _lines(rows, labels):
        x = np.array([index_of[row.pair] for row in line.rows])
        errors_mm = np.array([row.mean_error_mm for row in line.rows])
        faces = [line.colour if row.success else "none" for row in line.rows]
        marker = "s" if line.is_coarse else "o"
        axes.scatter(x, errors_mm, s=20, marker=marker, facecolors=faces, edgecolors=line.colour)
        axes.scatter([], [], s=20, marker=marker, color=line.colour, label=line.label)
    axes.set(yscale="log", xlabel="pair", ylabel="mean axis error (mm)")
    axes.set_ylim(top=min(axes.get_ylim()[1], FARTHEST_MM))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_beside(axes)
    return figure


def draw_times(summary: Sequence[dict[str, Any]], labels: dict[str, str]) -> Figure:
    """One bar per method, its stages stacked."""
    methods = list(dict.fromkeys(entry["method"] for entry in summary))
    figure, axes = new_figure(1.2 + 0.45 * len(methods))
    stage_s = {method: median_stages_s(summary, method) for method in methods}
    left_s = np.zeros(len(methods))
    for stage in STAGES:
        seconds = np.array([stage_s[method][stage] for method in methods])
        if seconds.any():
            axes.barh(
                range(len(methods)),
                seconds,
                left=left_s,
                color=STAGE_COLOURS[stage],
                label=STAGE_NAMES[stage],
                height=0.6,
            )
        left_s += seconds
    for y, total_s in enumerate(left_s):
        axes.text(total_s, y, f" {total_s:.2f} s", va="center")
    axes.set_yticks(range(len(methods)), [labels[method] for method in methods])
    axes.invert_yaxis()
    axes.margins(x=0.12)
    axes.set(xlabel="seconds (median over the pairs)")
    legend_beside(axes)
    return figure


def median_stages_s(summary: Sequence[dict[str, Any]], method: str) -> dict[str, float]:
    """Median seconds of the three stages of one method, 0 for those it does not have."""
    (median,) = (
        entry["median"]
        for entry in summary
        if (entry["method"], entry["stage"]) == (method, "fine")
    )
    before = {"map": median["map_s"] or 0.0, "transform": median["transform_s"] or 0.0}
    return {**before, "fine": max((median["total_s"] or 0.0) - sum(before.values()), 0.0)}


@dataclass(frozen=True)
class _Line:
    """A method's stage in a figure: one colour per method."""

    label: str
    colour: str
    is_coarse: bool
    rows: list[ScoreRow]


def _lines(rows: Sequence[ScoreRow], labels: dict[str, str]) -> list[_Line]:
    methods = list(dict.fromkeys(row.method for row in rows))
    keys = list(dict.fromkeys((row.method, row.stage) for row in rows))
    if len(methods) > MOST_WITH_COARSE:
        keys = [(method, "fine") for method in methods]
    both = {method for method, stage in keys if stage == "coarse"}
    return [
        _Line(
            label=row_label(labels[method], stage, method in both),
            colour=METHOD_COLOURS[methods.index(method) % len(METHOD_COLOURS)],
            is_coarse=stage == "coarse",
            rows=[row for row in rows if (row.method, row.stage) == (method, stage)],
        )
        for method, stage in keys
    ]
