"""Pieces of furniture: each function draws one, standing on z = 0 near the origin."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes.shapes import Surface, box, cylinder, moved, shifted, sphere
from skipnet.types import FloatArray


def plain_box(rng: np.random.Generator) -> list[Surface]:
    """A box of 0.4 to 1.6 m, as the paper's room has them."""
    return box(rng.uniform([0.4, 0.4, 0.3], [1.6, 1.6, 1.6]), hidden=("bottom",))


def stack(rng: np.random.Generator) -> list[Surface]:
    """A box on a box; the upper one stands back from the lower one's rim on every side."""
    lower = rng.uniform([0.7, 0.7, 0.4], [1.6, 1.6, 0.9])
    upper = np.append(lower[:2] * rng.uniform(0.4, 0.7, 2), rng.uniform(0.3, 0.8))
    offset_m = (lower[:2] - upper[:2]) / 2 * rng.uniform(-0.7, 0.7, 2)
    on_top = shifted(box(upper, hidden=("bottom",)), (*offset_m, lower[2]))
    return box(lower, hidden=("bottom",)) + on_top


def turned_stack(rng: np.random.Generator) -> list[Surface]:
    """A box on a box, turned against it by any angle."""
    lower = rng.uniform([0.8, 0.8, 0.4], [1.6, 1.6, 0.9])
    # The upper's half diagonal stays inside the lower's rim, whatever the angle.
    upper = np.append(rng.uniform(0.35, 0.65, 2) * lower[:2].min(), rng.uniform(0.3, 0.8))
    turn = make_transform(_turn(rng.uniform(0, 2 * np.pi)), np.array([0, 0, lower[2]]))
    return box(lower, hidden=("bottom",)) + moved(box(upper, hidden=("bottom",)), turn)


def tilted_box(rng: np.random.Generator) -> list[Surface]:
    """A box tipped by 10 to 50 degrees about a horizontal axis, its lowest edge on the floor."""
    axis_rad, tip_rad = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(10, 50))
    axis = np.array([np.cos(axis_rad), np.sin(axis_rad), 0.0])
    tip = make_transform(rotation_from_vector(tip_rad * axis), np.zeros(3))
    return _on_floor(moved(box(rng.uniform([0.4, 0.4, 0.3], [1.2, 1.2, 1.2])), tip))


def table(rng: np.random.Generator) -> list[Surface]:
    """A top on four legs that stand a little inside its rim."""
    length_m, depth_m, height_m = rng.uniform([1.2, 0.7, 0.65], [2.0, 1.0, 0.8])
    leg_m, top_m = rng.uniform(0.06, 0.12), rng.uniform(0.04, 0.08)
    x_m, y_m = length_m / 2 - leg_m / 2 - 0.05, depth_m / 2 - leg_m / 2 - 0.05
    leg = box(np.array([leg_m, leg_m, height_m - top_m]), hidden=("bottom", "top"))
    surfaces = shifted(box(np.array([length_m, depth_m, top_m])), (0, 0, height_m - top_m))
    for x, y in ((x_m, y_m), (-x_m, y_m), (-x_m, -y_m), (x_m, -y_m)):
        surfaces += shifted(leg, (x, y, 0))
    return surfaces


def shelf(rng: np.random.Generator) -> list[Surface]:
    """Two side panels, a back and boards; nothing is flush, so that no two faces share a plane."""
    width_m, depth_m, height_m = rng.uniform([0.8, 0.3, 1.2], [1.6, 0.45, 2.0])
    panel_m, step_back_m = 0.04, 0.02
    inner_m = width_m - 2 * panel_m
    side = box(np.array([panel_m, depth_m, height_m]), hidden=("bottom",))
    back = box(np.array([inner_m, panel_m, height_m - step_back_m]), ("bottom", "left", "right"))
    board_depth_m = depth_m - panel_m - 2 * step_back_m
    board = box(np.array([inner_m, board_depth_m, panel_m]), hidden=("left", "right", "back"))
    surfaces = shifted(side, (-(width_m - panel_m) / 2, 0, 0))
    surfaces += shifted(side, ((width_m - panel_m) / 2, 0, 0))
    surfaces += shifted(back, (0, (depth_m - panel_m) / 2 - step_back_m, 0))
    for z_m in np.linspace(0.1, height_m - 0.15, rng.integers(3, 6)):
        surfaces += shifted(board, (0, -panel_m / 2, z_m))
    return surfaces


def drum(rng: np.random.Generator) -> list[Surface]:
    """A cylinder standing on its end."""
    return cylinder(rng.uniform(0.2, 0.6), rng.uniform(0.4, 1.6), hidden=("bottom",))


def pipe(rng: np.random.Generator) -> list[Surface]:
    """A cylinder lying on its side."""
    lying = make_transform(rotation_from_vector(np.array([np.pi / 2, 0, 0])), np.zeros(3))
    return _on_floor(moved(cylinder(rng.uniform(0.15, 0.4), rng.uniform(0.8, 2.0)), lying))


def ball(rng: np.random.Generator) -> list[Surface]:
    """A sphere on the floor."""
    return sphere(rng.uniform(0.25, 0.7))


def ball_on_drum(rng: np.random.Generator) -> list[Surface]:
    """A sphere on a cylinder's top."""
    radius_m, height_m = rng.uniform(0.25, 0.45), rng.uniform(0.4, 1.0)
    ball_radius_m = rng.uniform(0.5, 0.9) * radius_m
    pedestal = cylinder(radius_m, height_m, hidden=("bottom",))
    return pedestal + shifted(sphere(ball_radius_m), (0, 0, height_m))


def column(rng: np.random.Generator, height_m: float) -> list[Surface]:
    """A round column from floor to ceiling."""
    return cylinder(rng.uniform(0.15, 0.4), height_m, hidden=("bottom", "top"))


def _turn(angle_rad: float) -> FloatArray:
    return rotation_from_vector(np.array([0.0, 0.0, angle_rad]))


def _on_floor(surfaces: list[Surface]) -> list[Surface]:
    lowest_m = min(surface.vertices_m[:, 2].min() for surface in surfaces)
    return shifted(surfaces, (0, 0, -lowest_m))
