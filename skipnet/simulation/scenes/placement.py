"""Where things may stand: sensors at their stations, furniture apart from all else."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes.shapes import Surface, moved
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


def separation_m(first_m: FloatArray, second_m: FloatArray) -> FloatArray:
    """A lower bound of the distance of convex polygons; negative where they meet.

    The largest gap along any edge normal (separating axes). A segment is a polygon of two corners.

    Args:
        first_m: (K, 2) corners of one polygon.
        second_m: (..., L, 2) corners of others.

    Returns:
        (...) of each of them from the first.

    >>> float(separation_m(square_m(np.zeros(2), 1.0), square_m(np.array([5.0, 1.0]), 1.0)))
    3.0
    """
    first_m = np.broadcast_to(first_m, (*second_m.shape[:-2], *first_m.shape))
    edges = np.concatenate([_next(p) - p for p in (first_m, second_m)], axis=-2)
    normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-2)
    normals /= np.sqrt((normals**2).sum(axis=-2, keepdims=True))
    first, second = first_m @ normals, second_m @ normals
    after = second.min(axis=-2) - first.max(axis=-2)
    before = first.min(axis=-2) - second.max(axis=-2)
    gaps: FloatArray = np.maximum(after, before).max(axis=-1)
    return gaps


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
        keep_free_m: rectangles (4, 2) where nothing may stand.
        turned_freely: turn each piece about z by any angle instead of by quarter turns.
    """
    ends_m = _next(corners_m)
    walls = np.stack([corners_m, ends_m, corners_m, ends_m], axis=1)  # of four corners, as the rest
    taken = np.concatenate([walls, np.reshape(keep_free_m, (-1, 4, 2))])
    placed: list[Surface] = []
    for maker in makers:
        piece = maker(rng)
        outline_m = footprint_m(piece)
        for _ in range(PLACEMENT_TRIES):
            turn_rad, place_m = _random_stand(rng, corners_m, turned_freely)
            if not contains(corners_m, place_m):
                continue
            T_world_piece = make_transform(
                rotation_from_vector(np.array([0, 0, turn_rad])), np.append(place_m, 0.0)
            )
            rectangle = outline_m @ T_world_piece[:2, :2].T + place_m
            if (separation_m(rectangle, taken) >= GAP_M).all():
                taken = np.concatenate([taken, rectangle[None]])
                placed += moved(piece, T_world_piece)
                break
    return placed


def square_m(centre_m: FloatArray, half_width_m: float) -> FloatArray:
    """(4, 2) corners of an axis-aligned square, for areas to keep free."""
    unit = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return np.asarray(centre_m) + half_width_m * unit


def contains(corners_m: FloatArray, point_m: FloatArray) -> bool:
    """Whether the polygon (K, 2) holds the point (2,): an odd number of edges lies to its right."""
    (x0, y0), (x1, y1) = corners_m.T, _next(corners_m).T
    crosses = (y0 > point_m[1]) != (y1 > point_m[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_x_m = x0 + (point_m[1] - y0) / (y1 - y0) * (x1 - x0)
    return bool(np.count_nonzero(crosses & (crossing_x_m > point_m[0])) % 2)


def _next(corners_m: FloatArray) -> FloatArray:
    """(..., K, 2) the corner after each."""
    return np.concatenate([corners_m[..., 1:, :], corners_m[..., :1, :]], axis=-2)


def _random_stand(
    rng: np.random.Generator, corners_m: FloatArray, turned_freely: bool
) -> tuple[float, FloatArray]:
    """Turn about z and (2,) place."""
    turn_rad = rng.uniform(0, 2 * np.pi) if turned_freely else rng.integers(4) * np.pi / 2
    return turn_rad, rng.uniform(corners_m.min(axis=0), corners_m.max(axis=0))
