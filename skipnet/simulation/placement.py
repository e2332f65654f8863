"""Where things may stand: sensors at their stations, furniture apart from all else."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.shapes import Surface, moved
from skipnet.types import FloatArray

Maker = Callable[[np.random.Generator], list[Surface]]
"""Draws one piece of furniture, standing on z = 0 near the origin."""

GAP_M = 0.3
"""Least distance of furniture from walls and from other furniture."""
PLACEMENT_TRIES = 60


@dataclass(frozen=True)
class Station:
    """A ring on the floor in which one sensor may stand."""

    centre_m: tuple[float, float]
    nearest_m: float
    """Inner radius; with 0 for both radii the sensor stands exactly at the centre."""
    farthest_m: float
    """Outer radius."""


@dataclass(frozen=True)
class Draft:
    """What a family draws."""

    surfaces: list[Surface]
    stations: tuple[Station, ...]
    """One per scan; further scans repeat the last."""


CENTRE_THEN_MOVED = (Station((0.0, 0.0), 0.0, 0.0), Station((0.0, 0.0), 1.0, 3.0))
"""The paper's two stations: the room's centre, and 1 to 3 m away from it."""


def footprint_m(surfaces: Iterable[Surface]) -> FloatArray:
    """(4, 2) corners of the bounding rectangle in x and y, counter-clockwise."""
    xy_m = np.concatenate([surface.vertices_m[:, :2] for surface in surfaces])
    (x0, y0), (x1, y1) = xy_m.min(axis=0), xy_m.max(axis=0)
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def separation_m(first_m: FloatArray, second_m: FloatArray) -> float:
    """A lower bound of the distance of two convex polygons (K, 2), (L, 2); negative if they meet.

    The largest gap along any edge normal (separating axes). A segment is a polygon of two corners.

    >>> separation_m(square_m(np.zeros(2), 1.0), square_m(np.array([5.0, 1.0]), 1.0))
    3.0
    """
    edges = np.concatenate([np.roll(p, -1, axis=0) - p for p in (first_m, second_m)])
    normals = np.column_stack([edges[:, 1], -edges[:, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first, second = first_m @ normals.T, second_m @ normals.T
    after = second.min(axis=0) - first.max(axis=0)
    before = first.min(axis=0) - second.max(axis=0)
    return float(np.maximum(after, before).max())


def furnish(
    rng: np.random.Generator,
    corners_m: FloatArray,
    makers: Sequence[Maker],
    keep_free_m: Sequence[FloatArray],
    turned_freely: bool = False,
) -> list[Surface]:
    """One piece per maker at random places in a room; a piece that finds no place stays out.

    Args:
        rng: draws pieces, places and turns.
        corners_m: (K, 2) floor plan, counter-clockwise.
        makers: what to place, one entry per piece.
        keep_free_m: convex polygons (L, 2) where nothing may stand.
        turned_freely: turn each piece about z by any angle instead of by quarter turns.
    """
    walls = [np.array(wall) for wall in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True)]
    taken = [*walls, *keep_free_m]
    placed: list[Surface] = []
    for maker in makers:
        piece = maker(rng)
        for _ in range(PLACEMENT_TRIES):
            T_world_piece = _random_stand(rng, corners_m, turned_freely)
            rectangle = footprint_m(piece) @ T_world_piece[:2, :2].T + T_world_piece[:2, 3]
            inside = contains(corners_m, T_world_piece[:2, 3])
            if inside and all(separation_m(rectangle, other) >= GAP_M for other in taken):
                taken.append(rectangle)
                placed += moved(piece, T_world_piece)
                break
    return placed


def square_m(centre_m: FloatArray, half_width_m: float) -> FloatArray:
    """(4, 2) corners of an axis-aligned square, for areas to keep free."""
    unit = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(centre_m) + half_width_m * unit


def contains(corners_m: FloatArray, point_m: FloatArray) -> bool:
    """Whether the polygon (K, 2) holds the point (2,): an odd number of edges lies to its right."""
    (x0, y0), (x1, y1) = corners_m.T, np.roll(corners_m, -1, axis=0).T
    crosses = (y0 > point_m[1]) != (y1 > point_m[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_x_m = x0 + (point_m[1] - y0) / (y1 - y0) * (x1 - x0)
    return bool(np.count_nonzero(crosses & (crossing_x_m > point_m[0])) % 2)


def _random_stand(
    rng: np.random.Generator, corners_m: FloatArray, turned_freely: bool
) -> FloatArray:
    turn_rad = rng.uniform(0, 2 * np.pi) if turned_freely else rng.integers(4) * np.pi / 2
    place_m = rng.uniform(corners_m.min(axis=0), corners_m.max(axis=0))
    return make_transform(rotation_from_vector(np.array([0, 0, turn_rad])), np.append(place_m, 0.0))
