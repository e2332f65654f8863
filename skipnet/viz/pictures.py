"""Pictures as Matplotlib figures: scans before and after, Skip-maps, confusion matrices.

Figures are made without pyplot, so nothing is global and no display is needed. All colours stay
apart for colour-blind readers: Okabe and Ito's palette for kinds, ``plasma`` (dark blue to bright
yellow) for values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skipnet.geometry import transform_points
from skipnet.types import FeatureClass, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from skipnet.viz.colours import (
    CLASS_COLOURS,
    CLASS_NAMES,
    CURVATURE_OF_BRIGHTEST,
    SOURCE_COLOUR,
    TARGET_COLOUR,
    class_colours,
    scan_colour,
)
from skipnet.viz.dots import DotPicture
from skipnet.viz.views import (
    add_legend,
    dots_by_columns,
    draw_clouds,
    draw_dots,
    new_figure,
    thin,
    views_by_columns,
)


def draw_before_after(
    source_m: FloatArray, target_m: FloatArray, T_target_source: FloatArray
) -> DotPicture:
    """Both scans in the target's frame, as they came and registered, from above and from the side.

    Args:
        source_m: (N, 3) points in the source's frame.
        target_m: (M, 3) points in the target's frame.
        T_target_source: (4, 4) the motion found.
    """
    source_m, target_m = thin(source_m), thin(target_m)
    after_m = transform_points(T_target_source, source_m)
    columns = {"before": [source_m, target_m], "after": [after_m, target_m]}
    colours = {"source": SOURCE_COLOUR, "target": TARGET_COLOUR}
    return dots_by_columns(np.concatenate([source_m, after_m, target_m]), columns, colours)


def draw_scans(scans_m: Sequence[FloatArray], names: Sequence[str]) -> Figure:
    """Many (N, 3) scans in one common frame, one colour each, from above and from the side."""
    colours = [scan_colour(index) for index in range(len(scans_m))]
    thinned_m = [thin(points_m) for points_m in scans_m]
    figure, views = views_by_columns(np.concatenate(thinned_m), [f"{len(scans_m)} scans"])
    for view in views:
        draw_clouds(view.columns[0], view.plane, thinned_m, colours)
    add_legend(figure, dict(zip(names, colours, strict=True)))
    return figure


def draw_skipmap_by_curvature(centroids_m: FloatArray, curvatures: FloatArray) -> Figure:
    """The paper's Skip-map picture: (V, 3) voxel centres by (V,) curvature, yellow where curved."""
    figure, views = views_by_columns(centroids_m, ["Skip-map"])
    order = np.argsort(curvatures)  # the curved ones on top: they are few
    for view in views:
        shades = curvatures[order]
        dots = draw_dots(
            view.columns[0], view.plane, centroids_m[order], c=shades, cmap="plasma", s=4
        )
        dots.set_clim(0, CURVATURE_OF_BRIGHTEST)
    label = "curvature l0 / (l0 + l1 + l2)"
    figure.colorbar(
        dots, ax=figure.axes, label=label, location="bottom", shrink=0.7, aspect=40, extend="max"
    )
    return figure


def draw_skipmap_by_class(centroids_m: FloatArray, classes: IntArray) -> Figure:
    """(V, 3) voxel centres in the colours of their (V,) ``FeatureClass``, corners on top."""
    figure, views = views_by_columns(centroids_m, ["classes"])
    order = np.argsort(-classes, kind="stable")
    sizes = np.where(
        classes <= FeatureClass.OTHER_CORNER, 16, np.where(classes == FeatureClass.EDGE, 6, 2)
    )
    tints = class_colours(classes[order]) / 255
    for view in views:
        draw_dots(view.columns[0], view.plane, centroids_m[order], c=tints, s=sizes[order])
    add_legend(figure, {CLASS_NAMES[kind]: colour for kind, colour in CLASS_COLOURS.items()})
    return figure


def draw_confusion_matrix(counts: IntArray, names: Sequence[str]) -> Figure:
    """A confusion matrix: shade and percentage by row (recall on the diagonal), counts beneath.

    Args:
        counts: (C, C) int, ``counts[true, predicted]``.
        names: the C classes.
    """
    counts = np.asarray(counts)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = new_figure(1.2 + 0.95 * len(names), 1.0 + 0.95 * len(names))
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for (row, column), share in np.ndenumerate(shares):
        text = f"{share:.0%}\n{counts[row, column]}"
        colour = "white" if share > 0.55 else "black"
        axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=9)
    ticks = range(len(names))
    axes.set_xticks(ticks, [name.replace(" ", "\n") for name in names])
    axes.set_yticks(ticks, [name.replace(" ", "\n") for name in names])
    axes.set(xlabel="predicted", ylabel="true")
    axes.tick_params(length=0)
    return figure
