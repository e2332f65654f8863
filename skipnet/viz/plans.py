"""Plan views: where scans stand, and which links hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skipnet.types import FloatArray
from skipnet.viz.colours import scan_colour
from skipnet.viz.views import thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DOTS_PER_SCAN = 3000
_WIDTH_IN = 7.0


@dataclass(frozen=True)
class PlanLink:
    """A line between two scans of a plan."""

    first: int
    second: int
    """Rows of the plan's scans."""
    width: float
    """0 to 1."""
    colour: str = "0.3"
    style: str = "-"


@dataclass(frozen=True)
class Plan:
    """One group from above."""

    title: str
    points_m: Sequence[FloatArray]
    """(N, 3) of each scan, in the group's frame."""
    origins_m: FloatArray
    """(S, 3) of each scan."""
    labels: Sequence[str]
    links: Sequence[PlanLink]


def draw_plans(plans: Sequence[Plan]) -> Figure:
    """Groups side by side, each seen along the direction in which it extends least."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH_IN * max(len(plans), 1), _WIDTH_IN), layout="constrained")
    for number, plan in enumerate(plans):
        _draw_plan(figure.add_subplot(1, len(plans), number + 1), plan)
    return figure


def _draw_plan(axes: Axes, plan: Plan) -> None:
    dots_m = [thin(points_m, _DOTS_PER_SCAN) for points_m in plan.points_m]
    middle_m, across = _view(np.concatenate(dots_m))
    for row, some_m in enumerate(dots_m):
        xy_m = (some_m - middle_m) @ across.T
        axes.plot(xy_m[:, 0], xy_m[:, 1], ",", color=scan_colour(row), alpha=0.5, rasterized=True)
    places_m = (plan.origins_m - middle_m) @ across.T
    for link in plan.links:
        ends_m = places_m[[link.first, link.second]]
        axes.plot(
            ends_m[:, 0],
            ends_m[:, 1],
            link.style,
            color=link.colour,
            linewidth=0.5 + 2.5 * link.width,
        )
    for row, label in enumerate(plan.labels):
        axes.plot(*places_m[row], "o", color=scan_colour(row), markeredgecolor="k")
        axes.annotate(label, places_m[row], textcoords="offset points", xytext=(5, 5))
    axes.set_aspect("equal")
    axes.set_title(plan.title)
    axes.set_xlabel("m")


def _view(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) middle and (2, 3) axes of the plane in which points spread most."""
    middle_m = points_m.mean(axis=0, dtype=np.float64)
    _, axes = np.linalg.eigh(np.cov((points_m - middle_m).T))
    return middle_m, axes[:, :0:-1].T
