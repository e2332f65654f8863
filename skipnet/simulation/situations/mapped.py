"""A scan, or a piece, of a part against the map of the whole, put together of many scans."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    anywhere,
    block,
    caster_of,
    drum,
    rings,
    see,
    upright,
)
from skipnet.types import FloatArray

STREET_M = 32.0
"""From the middle of a block of houses to that of the next."""
ROOM_M = 6.0
"""From the middle of a room to that of the next."""
_MAP_RINGS = rings(400, 48, -25.0, 15.0)
_ROOM_RINGS = rings(320, 90, -60.0, 60.0)
_SENSORS = rings(900, 32, -25.0, 12.0), rings(900, 16, -15.0, 15.0)


def mapped(seed: int) -> Situation:
    """A street's scan by 32 or 16 lines or a piece cut out, against the town's map; a room's scan
    against its floor's."""
    rng = np.random.default_rng([seed, 11])
    if seed % 2:
        return _room_on_floor(rng)
    solids = _town(rng)
    eyes_m = [((i - 1) * STREET_M, (j - 1) * STREET_M, 2.0) for i in range(3) for j in range(3)]
    map_m = _fuse(solids, eyes_m, _MAP_RINGS, 0.02, 70.0, 0.2, rng)
    if seed % 3 == 0:
        middle_m = rng.uniform(-STREET_M, STREET_M, 2)
        near = np.linalg.norm(map_m[:, :2] - middle_m, axis=1) < rng.uniform(15, 25)
        piece_m = map_m[near & (rng.random(len(map_m)) < 0.5)]
        piece_m = piece_m + rng.normal(0, 0.02, piece_m.shape)
        T = anywhere(rng, 20.0)
        return Situation("map, piece", transform_points(invert(T), piece_m), map_m, T)
    place_m = [*(rng.integers(-1, 2, 2) * STREET_M + rng.uniform(-5, 5, 2)), 2.0]
    T = upright(rng.uniform(-3, 3), place_m)
    ways, lines = _SENSORS[seed % 4 // 2], (32, 16)[seed % 4 // 2]
    source_m = see(caster_of(solids), T, ways, 0.02, rng, rng.uniform(25, 45))
    return Situation(f"map, {lines} lines", source_m, map_m, T)


def _room_on_floor(rng: np.random.Generator) -> Situation:
    """Ten rooms along a corridor, each with other furniture."""
    solids = block((30, 14, 0.1), (0, 0, -0.05)) + block((30, 14, 0.1), (0, 0, 2.85))
    rooms_m = [(x, y) for x in ROOM_M * np.arange(-2, 3) for y in (-4.0, 4.0)]
    for x_m in ROOM_M * np.arange(-2.5, 3.0):
        solids += block((0.12, 6, 2.8), (x_m, 4, 1.4)) + block((0.12, 6, 2.8), (x_m, -4, 1.4))
    for side in (-1, 1):
        solids += block((30, 0.15, 2.8), (0, 7 * side, 1.4))
        for x_m in ROOM_M * np.arange(-2, 3):
            solids += block((4.9, 0.12, 2.8), (x_m - 0.5, side, 1.4))
    for x_m, y_m in rooms_m:
        for _ in range(4):
            size_m = rng.uniform(0.3, 1.4, 3)
            at_m = x_m + rng.uniform(-2, 2), y_m + rng.uniform(-2, 2), size_m[2] / 2
            solids += block(size_m, at_m, rng.uniform(0, 3))
    eyes_m = [(*room_m, 1.5) for room_m in rooms_m] + [(x, 0.0, 1.5) for x in (-9.0, 0.0, 9.0)]
    map_m = _fuse(solids, eyes_m, _ROOM_RINGS, 0.005, 15.0, 0.04, rng)
    place_m = [*(np.array(rooms_m[rng.integers(len(rooms_m))]) + rng.uniform(-1, 1, 2)), 1.5]
    T = upright(rng.uniform(-3, 3), place_m)
    source_m = see(caster_of(solids), T, _ROOM_RINGS, 0.004, rng, 6.0)
    return Situation("map, room", source_m, map_m, T)


def _town(rng: np.random.Generator) -> Solids:
    """Houses in blocks, some missing, and poles."""
    solids = block((160, 160, 0.2), (0, 0, -0.1))
    for i, j in np.ndindex(4, 4):
        if rng.random() > 0.2:
            at_m = (np.array([i, j]) - 1.5) * STREET_M + rng.uniform(-3, 3, 2)
            size_m = rng.uniform([10, 10, 4], [22, 22, 14])
            solids += block(size_m, (*at_m, size_m[2] / 2), rng.uniform(-0.2, 0.2))
    for _ in range(40):
        solids += drum(0.25, 6.0, (*rng.uniform(-70, 70, 2), 3.0))
    return solids


def _fuse(
    solids: Solids,
    eyes_m: list[tuple[float, float, float]],
    ways: FloatArray,
    sigma_m: float,
    farthest_m: float,
    spacing_m: float,
    rng: np.random.Generator,
) -> FloatArray:
    """(N, 3) what was seen from all places, in the world's frame, a point for each spacing."""
    caster, seen_m = caster_of(solids), []
    for eye_m in eyes_m:
        T = upright(rng.uniform(-3, 3), eye_m)
        seen_m.append(transform_points(T, see(caster, T, ways, sigma_m, rng, farthest_m)))
    points_m = np.concatenate(seen_m)
    cells = np.round(points_m / spacing_m).astype(np.int64)
    return points_m[np.unique(cells, axis=0, return_index=True)[1]]
