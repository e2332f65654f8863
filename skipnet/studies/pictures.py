"""The pictures of the documentation, made from simulated scans: the paper's figures, our data."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.geometry import transform_points
from skipnet.networks.names import SHIPPED, weights_file
from skipnet.registration.pipeline import register
from skipnet.scans.describing import describe
from skipnet.scans.scan import Scan
from skipnet.simulation.scanning.pairs import SimulatedPair, simulate_pair
from skipnet.simulation.seeds import DEMO
from skipnet.storage import write_bytes
from skipnet.studies.options import PicturesConfig
from skipnet.viz import pictures
from skipnet.viz.colours import scan_colour
from skipnet.viz.views import png_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from skipnet.viz.dots import DotPicture

DPI, COLOURS = 90, 64
"""Small files: they are kept with the documentation."""


def run(config: PicturesConfig) -> dict[str, Any]:
    """Draw every picture and name the files."""
    written = draw_documentation(Path(config.output_dir), config.seed)
    print("\n".join(str(path) for path in written))
    return {"written": [str(path) for path in written]}


def draw_documentation(folder: Path, seed: int = 0) -> list[Path]:
    """Draw every picture of docs/ into a folder.

    Args:
        folder: made when missing; files of the same names are replaced.
        seed: number of the simulated room (``skipnet.simulation.seeds.DEMO``).

    Returns:
        The files, in the order of the pipeline.
    """
    simulated = simulate_pair("paper_room", DEMO.scene(seed))
    scan = describe([simulated.target.points_m], ["auto"])[0]
    drawings: dict[str, Callable[[], Figure | DotPicture]] = {
        "scene": lambda: draw_scene(simulated),
        "skipmap": lambda: _draw_skipmap(scan),
        "classes": lambda: _draw_classes(scan),
        "network": draw_network,
        "before_after": lambda: _draw_before_after(simulated),
    }
    written = []
    for name, draw in drawings.items():
        written.append(folder / f"{name}.png")
        write_bytes(written[-1], png_bytes(draw(), DPI, COLOURS))
    return written


def draw_scene(simulated: SimulatedPair) -> Figure:
    """The scene and both sensors, with the true points of their scans, in the world frame."""
    scans = simulated.target, simulated.source
    scans_m = [transform_points(scan.T_world_sensor, scan.true_points_m) for scan in scans]
    figure = pictures.draw_scans(scans_m, ["first scan", "second scan"])
    for number, scan in enumerate(scans):
        x_m, y_m, z_m = scan.T_world_sensor[:3, 3]
        for axes, up_m in zip(figure.axes, (y_m, z_m), strict=True):
            star = axes.scatter(x_m, up_m, s=320, marker="*", edgecolors="black", zorder=9)
            star.set_facecolor(scan_colour(number))
    return figure


def _draw_skipmap(scan: Scan) -> Figure:
    return pictures.draw_skipmap_by_curvature(_given_m(scan), scan.skipmap.curvatures)


def _draw_classes(scan: Scan) -> Figure:
    rows = scan.features.rows
    return pictures.draw_skipmap_by_class(_given_m(scan)[rows], scan.features.classes)


def _given_m(scan: Scan) -> np.ndarray:
    """(V, 3) centroids of the scan's voxels in the frame in which it was given."""
    return transform_points(scan.T_given_own, scan.skipmap.centroids_m)


def _draw_before_after(simulated: SimulatedPair) -> DotPicture:
    pair = simulated.pair
    result = register(pair.source_m, pair.target_m)
    return pictures.draw_before_after(pair.source_m, pair.target_m, result.T_target_source)


def draw_network() -> Figure:
    """The shipped network: what each layer reads and how many units it has, from its weights."""
    from matplotlib.figure import Figure

    with np.load(weights_file(SHIPPED)) as stored:
        names = [name for name in stored.files if name.endswith("_weight")]
        sizes = {name.removesuffix("_weight"): stored[name].shape for name in names}
    boxes = {
        "sector": (2.2, 1.6, "sectors of two cylinders\n10 and 20 voxels around"),
        "mixing": (4.4, 1.6, "mixed over the sectors"),
        "output": (6.9, 2.4, "descriptor"),
        "matchable": (6.9, 1.2, "will it be found again?"),
        "detail": (2.2, 0.0, "the paper's 125 cells"),
        "joint": (4.4, 0.0, "cells and hidden units"),
        "classes": (6.9, 0.0, "five classes"),
    }
    arrows = [("sector", "mixing"), ("mixing", "output"), ("mixing", "matchable")]
    arrows += [("detail", "joint"), ("mixing", "joint"), ("joint", "classes")]
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots()
    for name, (x, y, text) in boxes.items():
        _draw_box(axes, x, y, f"{text}\n{sizes[name][0]} → {sizes[name][1]}")
    for start, end in arrows:
        _draw_arrow(axes, boxes[start][:2], boxes[end][:2])
    axes.set(xlim=(1.0, 8.2), ylim=(-0.6, 3.0))
    axes.axis("off")
    return figure


def _draw_box(axes: Axes, x: float, y: float, text: str) -> None:
    box = {"boxstyle": "round,pad=0.5", "facecolor": "#eef4fb", "edgecolor": "#0072B2"}
    axes.text(x, y, text, ha="center", va="center", fontsize=9, bbox=box)


def _draw_arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    look = {"arrowstyle": "->", "color": "#555555", "shrinkA": 62, "shrinkB": 62}
    if start[0] == end[0]:
        look |= {"shrinkA": 26, "shrinkB": 26}
    axes.annotate("", xy=end, xytext=start, arrowprops=look)
