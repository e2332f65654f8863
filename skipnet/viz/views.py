"""What every picture is made of: views from above and from the side, dots, legends, files."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from skipnet.types import FloatArray, IntArray
from skipnet.viz.dots import DotPicture, DotView

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure

_MOST_DOTS = 20_000
_BOUNDING = 40_000
_THINNING_CELLS = 200
_TALLEST_IN = 10.0
_TURNS = 8
_COMPRESSION = 4
"""Of 9: more takes longer than it saves."""
_BESIDE_IN = 0.65
"""What axes leave of a column's width to the numbers beside them."""


_LEGEND_CHARACTERS_PER_INCH = 11


class View(NamedTuple):
    """One view of a scene: its axes by column, and which coordinates run to the right and up."""

    columns: list[Axes]
    plane: tuple[int, int]


def png_bytes(figure: Figure | DotPicture, dpi: int = 130, colours: int | None = None) -> bytes:
    """A picture as a PNG file's content.

    Args:
        figure: to draw.
        dpi: pixels per inch.
        colours: a palette of so many (2 to 256), which makes pictures of scans a third as large;
            None keeps all.
    """
    buffer = io.BytesIO()
    if isinstance(figure, DotPicture):
        figure.image(dpi).save(buffer, format="png", compress_level=_COMPRESSION)
    else:
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


def thin(points_m: FloatArray, most: int = _MOST_DOTS) -> FloatArray:
    """At most ``most`` of the points, even over space.

    Otherwise the dense part of a scan, near the sensor, would hide the rest.
    """
    points_m = np.asarray(points_m)
    return points_m[thin_rows(points_m, most)]


def thin_rows(points_m: FloatArray, most: int, cells: int = _THINNING_CELLS) -> IntArray:
    """Rows of at most ``most`` points, one at most in each cell of which ``cells`` span them."""
    low_m, high_m = robust_bounds_m(points_m)
    cell_m = max(float((high_m - low_m).max()), 1e-9) / cells
    farthest = 10 * cells
    x, y, z = np.clip((points_m - low_m) / cell_m, -farthest, farthest).astype(np.int64).T
    width = 2 * farthest + 1
    _, first = np.unique((x * width + y) * width + z, return_index=True)
    if len(first) > most:
        first = np.random.default_rng(0).choice(first, most, replace=False)
    return first


def robust_bounds_m(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) lower and upper corner of all but the outermost points, by some of very many."""
    some_m = points_m[:: 1 + len(points_m) // _BOUNDING]
    low_m, high_m = np.percentile(some_m, [0.2, 99.8], axis=0)
    return low_m, high_m


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure without pyplot: nothing global, no display."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def views_by_columns(points_m: FloatArray, titles: Sequence[str]) -> tuple[Figure, list[View]]:
    """A figure with a row of axes per view and a column per title, to the scale of the points."""
    low_m, high_m, planes = _planes(points_m)
    heights = [_slope(high_m - low_m, plane) for plane in planes.values()]
    width_in = _width_in(len(titles), heights)
    figure = new_figure(max(width_in, 4.0) * len(titles), width_in * sum(heights) + 1.6)
    grid = figure.subplots(len(planes), len(titles), height_ratios=heights, squeeze=False)
    for row, (name, (right, up)) in zip(grid, planes.items(), strict=True):
        for axes, title in zip(row, titles, strict=True):
            axes.set_title(f"{title}, {name}")
            axes.set_aspect("equal", adjustable="box")
            axes.set(xlim=(low_m[right], high_m[right]), ylim=(low_m[up], high_m[up]))
            axes.set(xlabel=f"{'xyz'[right]} (m)", ylabel=f"{'xyz'[up]} (m)")
            axes.grid(color="#e6e6e6", linewidth=0.6)
            axes.set_axisbelow(True)
            if _runs_down(right, up):
                axes.invert_yaxis()
    return figure, [
        View(list(row), plane) for row, plane in zip(grid, planes.values(), strict=True)
    ]


def dots_by_columns(
    points_m: FloatArray, columns: Mapping[str, Sequence[FloatArray]], colours: dict[str, str]
) -> DotPicture:
    """Clouds in the same views and to the same scale as ``views_by_columns`` has them.

    Args:
        points_m: (N, 3) what sets the scale.
        columns: title to (N, 3) clouds.
        colours: name of each cloud to its colour.
    """
    low_m, high_m, planes = _planes(points_m)
    rows = []
    for name, (right, up) in planes.items():
        plane, names = [right, up], (f"{'xyz'[right]} (m)", f"{'xyz'[up]} (m)")
        rows.append([
            DotView(f"{title}, {name}", names, low_m[plane], high_m[plane],
                    _runs_down(right, up), [cloud_m[:, plane] for cloud_m in clouds_m])
            for title, clouds_m in columns.items()
        ])  # fmt: skip
    heights = [_slope(high_m - low_m, plane) for plane in planes.values()]
    return DotPicture(rows, colours, _width_in(len(columns), heights) - _BESIDE_IN)


def _planes(
    points_m: FloatArray,
) -> tuple[FloatArray, FloatArray, dict[str, tuple[int, int]]]:
    """(3,) corners of what is shown, and of each view which coordinates run to the right and up.

    The clearly longer of x and y runs to the right. A far stray point does not set the scale.
    """
    low_m, high_m = robust_bounds_m(points_m)
    margin_m = 0.05 * float((high_m - low_m).max()) + 1e-6
    low_m, high_m = low_m - margin_m, high_m + margin_m
    extent_m = high_m - low_m
    right, other = (1, 0) if extent_m[1] > 1.1 * extent_m[0] else (0, 1)
    return low_m, high_m, {"from above": (right, other), "from the side": (right, 2)}


def _runs_down(right: int, up: int) -> bool:
    """Still seen from above: with y to the right, x points down."""
    return right == 1 and up == 0


def _slope(extent_m: FloatArray, plane: tuple[int, int]) -> float:
    return float(extent_m[plane[1]] / extent_m[plane[0]])


def _width_in(columns: int, heights: Sequence[float]) -> float:
    """Of a column, so that all of it fits on a page."""
    return min(5.5 if columns > 1 else 7.5, _TALLEST_IN / sum(heights))


def draw_clouds(
    axes: Axes, plane: tuple[int, int], clouds_m: Sequence[FloatArray], colours: Sequence[str]
) -> None:
    """Clouds in turns of a share each, so that none hides another.

    Matplotlib stamps the markers of a plot many times faster than it paints those of a scatter.
    """
    shuffled_m = [np.random.default_rng(0).permutation(cloud_m)[:, plane] for cloud_m in clouds_m]
    for turn in range(_TURNS):
        for cloud_m, colour in zip(shuffled_m, colours, strict=True):
            axes.plot(*cloud_m[turn::_TURNS].T, "o", markersize=1.4, mew=0, color=colour, alpha=0.7)


def draw_dots(
    axes: Axes, plane: tuple[int, int], points_m: FloatArray, **style: Any
) -> PathCollection:
    """Draw (N, 3) points as dots of one view, in the style given."""
    horizontal, vertical = plane
    return axes.scatter(points_m[:, horizontal], points_m[:, vertical], linewidths=0, **style)


def add_legend(figure: Figure, colours: dict[str, str]) -> None:
    """Say below the views which colour is what."""
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], marker="o", linestyle="", markersize=8, color=colour, label=name)
        for name, colour in colours.items()
    ]
    longest = max(len(name) for name in colours) + 6  # with its dot and a gap
    fit = int(figure.get_figwidth() * _LEGEND_CHARACTERS_PER_INCH / longest)
    columns = int(np.clip(fit, 1, min(len(marks), 5)))
    figure.legend(handles=marks, loc="outside lower center", ncols=columns, frameon=False)
