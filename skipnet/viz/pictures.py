"""Pictures as Matplotlib figures: scans before and after, Skip-maps, confusion matrices.

Figures are made without pyplot, so nothing is global and no display is needed. All colours stay
apart for colour-blind readers: Okabe and Ito's palette for kinds, ``plasma`` (dark blue to bright
yellow) for values.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from skipnet.geometry import transform_points
from skipnet.types import FeatureClass, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure

SOURCE_COLOUR = "#D55E00"
TARGET_COLOUR = "#0072B2"
SCAN_COLOURS = (TARGET_COLOUR, SOURCE_COLOUR, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
CLASS_COLOURS = {
    FeatureClass.FIRST_CORNER: "#D55E00",
    FeatureClass.SECOND_CORNER: "#0072B2",
    FeatureClass.OTHER_CORNER: "#CC79A7",
    FeatureClass.EDGE: "#009E73",
    FeatureClass.PLANE: "#D0D0D0",
}
CLASS_NAMES = {kind: kind.name.replace("_", " ").lower() for kind in FeatureClass}

CURVATURE_OF_BRIGHTEST = 0.12
"""Curvature shown as the brightest yellow: about that of a right-angled corner's neighbourhood."""
_MOST_DOTS = 20_000
_THINNING_CELLS = 200
_TALLEST_IN = 10.0
_TURNS = 8


class _View(NamedTuple):
    """One view of a scene: its axes by column, and which coordinates run to the right and up."""

    columns: list[Axes]
    plane: tuple[int, int]


def png_bytes(figure: Figure, dpi: int = 130, colours: int | None = None) -> bytes:
    """The figure as a PNG file's content.

    Args:
        figure: to draw.
        dpi: pixels per inch.
        colours: a palette of so many (2 to 256), which makes pictures of scans a third as large;
            None keeps all.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, facecolor="white")
    if colours is None:
        return buffer.getvalue()
    from PIL import Image

    smaller = io.BytesIO()
    image = (
        Image.open(buffer)
        .convert("RGB")
        .quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    )
    image.save(smaller, format="png", optimize=True)
    return smaller.getvalue()


def draw_before_after(
    source_m: FloatArray, target_m: FloatArray, T_target_source: FloatArray
) -> Figure:
    """Both scans in the target's frame, as they came and registered, from above and from the side.

    Args:
        source_m: (N, 3) points in the source's frame.
        target_m: (M, 3) points in the target's frame.
        T_target_source: (4, 4) the motion found.
    """
    source_m, target_m = thin(source_m), thin(target_m)
    after_m = transform_points(T_target_source, source_m)
    figure, views = _views_by_columns(
        np.concatenate([source_m, after_m, target_m]), ["before", "after"]
    )
    for view in views:
        for axes, moved_m in zip(view.columns, (source_m, after_m), strict=True):
            _draw_clouds(axes, view.plane, [moved_m, target_m], [SOURCE_COLOUR, TARGET_COLOUR])
    _add_legend(figure, {"source": SOURCE_COLOUR, "target": TARGET_COLOUR})
    return figure


def draw_scans(scans_m: Sequence[FloatArray], names: Sequence[str]) -> Figure:
    """Many (N, 3) scans in one common frame, one colour each, from above and from the side."""
    colours = [scan_colour(index) for index in range(len(scans_m))]
    thinned_m = [thin(points_m) for points_m in scans_m]
    figure, views = _views_by_columns(np.concatenate(thinned_m), [f"{len(scans_m)} scans"])
    for view in views:
        _draw_clouds(view.columns[0], view.plane, thinned_m, colours)
    _add_legend(figure, dict(zip(names, colours, strict=True)))
    return figure


def draw_skipmap_by_curvature(centroids_m: FloatArray, curvatures: FloatArray) -> Figure:
    """The paper's Skip-map picture: (V, 3) voxel centres by (V,) curvature, yellow where curved."""
    figure, views = _views_by_columns(centroids_m, ["Skip-map"])
    order = np.argsort(curvatures)  # the curved ones on top: they are few
    for view in views:
        shades = curvatures[order]
        dots = _draw_dots(
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
    figure, views = _views_by_columns(centroids_m, ["classes"])
    order = np.argsort(-classes, kind="stable")
    sizes = np.where(
        classes <= FeatureClass.OTHER_CORNER, 16, np.where(classes == FeatureClass.EDGE, 6, 2)
    )
    tints = class_colours(classes[order]) / 255
    for view in views:
        _draw_dots(view.columns[0], view.plane, centroids_m[order], c=tints, s=sizes[order])
    _add_legend(figure, {CLASS_NAMES[kind]: colour for kind, colour in CLASS_COLOURS.items()})
    return figure


def draw_confusion_matrix(counts: IntArray, names: Sequence[str]) -> Figure:
    """A confusion matrix: shade and percentage by row (recall on the diagonal), counts beneath.

    Args:
        counts: (C, C) int, ``counts[true, predicted]``.
        names: the C classes.
    """
    counts = np.asarray(counts)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = _new_figure(1.2 + 0.95 * len(names), 1.0 + 0.95 * len(names))
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


def scan_colour(index: int) -> str:
    """Colour of the scan with this number, as ``#RRGGBB``."""
    return SCAN_COLOURS[index % len(SCAN_COLOURS)]


def curvature_colours(curvatures: FloatArray) -> IntArray:
    """(V, 3) uint8 red, green, blue: dark blue for 0, yellow for ``CURVATURE_OF_BRIGHTEST``."""
    from matplotlib import colormaps

    share = np.clip(np.asarray(curvatures) / CURVATURE_OF_BRIGHTEST, 0, 1)
    return colormaps["plasma"](share, bytes=True)[:, :3]


def class_colours(classes: IntArray) -> IntArray:
    """(V, 3) uint8 red, green, blue of (V,) ``FeatureClass`` values."""
    from matplotlib.colors import to_rgb

    palette = np.array([to_rgb(CLASS_COLOURS[kind]) for kind in FeatureClass])
    return (palette * 255).round().astype(np.uint8)[np.asarray(classes)]


def thin(points_m: FloatArray, most: int = _MOST_DOTS) -> FloatArray:
    """At most ``most`` of the points, even over space.

    Otherwise the dense part of a scan, near the sensor, would hide the rest.
    """
    points_m = np.asarray(points_m)
    low_m, high_m = _robust_bounds_m(points_m)
    cell_m = max(float((high_m - low_m).max()), 1e-9) / _THINNING_CELLS
    farthest = 10 * _THINNING_CELLS
    x, y, z = np.clip((points_m - low_m) / cell_m, -farthest, farthest).astype(np.int64).T
    width = 2 * farthest + 1
    _, first = np.unique((x * width + y) * width + z, return_index=True)
    if len(first) > most:
        first = np.random.default_rng(0).choice(first, most, replace=False)
    return points_m[first]


def _robust_bounds_m(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) lower and upper corner of all but the outermost points."""
    low_m, high_m = np.percentile(points_m, [0.2, 99.8], axis=0)
    return low_m, high_m


def _new_figure(width_in: float, height_in: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def _views_by_columns(points_m: FloatArray, titles: Sequence[str]) -> tuple[Figure, list[_View]]:
    """A figure with a row of axes per view and a column per title, all to the scale of the points.

    The clearly longer of x and y runs to the right. A far stray point does not set the scale.
    """
    low_m, high_m = _robust_bounds_m(points_m)
    margin_m = 0.05 * float((high_m - low_m).max()) + 1e-6
    low_m, high_m = low_m - margin_m, high_m + margin_m
    extent_m = high_m - low_m
    right, other = (1, 0) if extent_m[1] > 1.1 * extent_m[0] else (0, 1)
    planes = {"from above": (right, other), "from the side": (right, 2)}
    heights = [float(extent_m[up] / extent_m[right]) for _, up in planes.values()]
    width_in = min(5.5 if len(titles) > 1 else 7.5, _TALLEST_IN / sum(heights))
    figure = _new_figure(max(width_in, 4.0) * len(titles), width_in * sum(heights) + 1.6)
    grid = figure.subplots(len(planes), len(titles), height_ratios=heights, squeeze=False)
    for row, (name, (right, up)) in zip(grid, planes.items(), strict=True):
        for axes, title in zip(row, titles, strict=True):
            axes.set_title(f"{title}, {name}")
            axes.set_aspect("equal", adjustable="box")
            axes.set(xlim=(low_m[right], high_m[right]), ylim=(low_m[up], high_m[up]))
            axes.set(xlabel=f"{'xyz'[right]} (m)", ylabel=f"{'xyz'[up]} (m)")
            axes.grid(color="#e6e6e6", linewidth=0.6)
            axes.set_axisbelow(True)
            if right == 1 and up == 0:
                axes.invert_yaxis()  # still seen from above: with y to the right, x points down
    return figure, [
        _View(list(row), plane) for row, plane in zip(grid, planes.values(), strict=True)
    ]


def _draw_clouds(
    axes: Axes, plane: tuple[int, int], clouds_m: Sequence[FloatArray], colours: Sequence[str]
) -> None:
    """Clouds in turns of a share each, so that none hides another.

    Matplotlib stamps the markers of a plot many times faster than it paints those of a scatter.
    """
    shuffled_m = [np.random.default_rng(0).permutation(cloud_m)[:, plane] for cloud_m in clouds_m]
    for turn in range(_TURNS):
        for cloud_m, colour in zip(shuffled_m, colours, strict=True):
            axes.plot(*cloud_m[turn::_TURNS].T, "o", markersize=1.4, mew=0, color=colour, alpha=0.7)


def _draw_dots(
    axes: Axes, plane: tuple[int, int], points_m: FloatArray, **style: Any
) -> PathCollection:
    horizontal, vertical = plane
    return axes.scatter(points_m[:, horizontal], points_m[:, vertical], linewidths=0, **style)


_LEGEND_CHARACTERS_PER_INCH = 11


def _add_legend(figure: Figure, colours: dict[str, str]) -> None:
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], marker="o", linestyle="", markersize=8, color=colour, label=name)
        for name, colour in colours.items()
    ]
    longest = max(len(name) for name in colours) + 6  # with its dot and a gap
    fit = int(figure.get_figwidth() * _LEGEND_CHARACTERS_PER_INCH / longest)
    columns = int(np.clip(fit, 1, min(len(marks), 5)))
    figure.legend(handles=marks, loc="outside lower center", ncols=columns, frameon=False)
