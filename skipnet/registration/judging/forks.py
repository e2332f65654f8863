"""Do two surfaces part? One specimen has a boss where the other one goes on flat.

What one scan shows and the other does not says nothing in itself: the other sensor may not have
seen it. But then the other scan's surface ends there. Where it goes on all the same, another way,
the scans show two things, or one that was changed. That needs no sensor's place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import invert, transform_points
from skipnet.scans.scan import Scan
from skipnet.skipmap.cells import cells_of
from skipnet.skipmap.connected import AROUND, WITHIN_TWO, connected
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

FEWEST_VOXELS, MOST_PIECES = 12, 8
"""Of a piece of surface that one scan has alone, fine ones; the largest few are looked at."""
MIN_RIM, MOST_RIM = 8, 100
"""Voxels of the other scan along its rim, where it still lies on it; so many of them are asked."""
MIN_GOING_ON = 0.3
"""The scans part where the other one's surface goes on at so much of the rim. Under right poses of
79 simulated objects, seen in part, sampled, noisy or drifting, it does at 0.12 at most; of 38 other
specimens 36 have a piece with 0.43 and more."""
REACH_VOXELS = 4
"""How far about a voxel its surface is looked for, in ``SECTORS`` of its plane: in each of them."""
SECTORS, NEAREST_VOXELS, THICK_VOXELS = 8, 1.5, 1.6
_SPAN = range(-REACH_VOXELS, REACH_VOXELS + 1)
_BALL = np.array(
    [(x, y, z) for x in _SPAN for y in _SPAN for z in _SPAN if x * x + y * y + z * z <= 16]
)


def find_forks(T_target_source: FloatArray, source: Scan, target: Scan) -> FloatArray:
    """(P, 3) where the scans' surfaces part under a (4, 4) pose, target frame."""
    return np.array(list(_forks(T_target_source, source, target))).reshape(-1, 3)


def surfaces_part(T_target_source: FloatArray, source: Scan, target: Scan) -> bool:
    """Whether they do so anywhere."""
    return next(_forks(T_target_source, source, target), None) is not None


def _forks(T_target_source: FloatArray, source: Scan, target: Scan) -> Iterator[FloatArray]:
    """(3,) each in the target's frame."""
    yield from _one_way(T_target_source, source, target)
    for place_m in _one_way(invert(T_target_source), target, source):
        yield transform_points(T_target_source, place_m[None])[0]


def _one_way(T_b_a: FloatArray, scan_a: Scan, scan_b: Scan) -> Iterator[FloatArray]:
    """(3,) middles of a's pieces at which b parts from it, b's frame."""
    a, b = scan_a.fine_skipmap, scan_b.fine_skipmap
    rows_b = scan_b.fine_near.find_moved(T_b_a[None], a.centroids_m)[0]
    rows = np.flatnonzero(rows_b < 0)
    around = a.find_around(rows, AROUND)
    for piece in _largest(connected(around, rows, len(a))):
        rim = around[piece]
        rim = np.unique(rows_b[rim[rim >= 0]])
        rim = rim[rim >= 0]
        if len(rim) < MIN_RIM:
            continue
        rim = rim[_spread(len(rim), MOST_RIM)]
        goes_on = _goes_on(b.find_around(rim, _BALL), rim, b.centroids_m, b.normals, b.voxel_size_m)
        points_m = transform_points(T_b_a, a.centroids_m[rows[piece]])
        if goes_on.mean() >= MIN_GOING_ON and _is_deep(b, points_m):
            yield points_m.mean(axis=0)


def _largest(number: IntArray) -> list[IntArray]:
    """Places of the members of the largest groups, by (K,) numbers; largest first."""
    sizes = np.bincount(number)
    largest = np.argsort(-sizes, kind="stable")[:MOST_PIECES]
    return [np.flatnonzero(number == k) for k in largest[sizes[largest] >= FEWEST_VOXELS]]


def _spread(count: int, most: int) -> IntArray:
    """At most so many of the first ``count`` numbers, evenly spread."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.int64)


def _is_deep(b: SkipMap, points_m: FloatArray) -> bool:
    """Whether some of (N, 3) points have nothing of b within two cells."""
    cells = cells_of(points_m, b.voxel_size_m, b.origin_m)
    return bool((b.table.find_around(cells, WITHIN_TWO) < 0).all(axis=1).any())


@compiled
def _goes_on(
    near: IntArray, rows: IntArray, points_m: FloatArray, normals: FloatArray, voxel_m: float
) -> BoolArray:
    """(K,) whether a surface goes on in every direction from each of (K,) of its voxels.

    Args:
        near: (K, O) rows of the voxels within ``REACH_VOXELS`` of each, -1 for none.
        rows: (K,) theirs.
        points_m: (V, 3) centroids.
        normals: (V, 3) unit normals.
        voxel_m: edge of a voxel.
    """
    goes_on = np.zeros(len(rows), dtype=np.bool_)
    for k in range(len(rows)):
        normal = normals[rows[k]]
        side = np.zeros(3)
        side[np.abs(normal).argmin()] = 1.0
        first = np.cross(normal, side)
        first /= np.sqrt((first**2).sum())
        second = np.cross(normal, first)
        has = 0
        for o in range(near.shape[1]):
            if near[k, o] < 0:
                continue
            away = (points_m[near[k, o]] - points_m[rows[k]]) / voxel_m
            x, y = (away * first).sum(), (away * second).sum()
            is_thin = abs((away * normal).sum()) < THICK_VOXELS
            if is_thin and x * x + y * y > NEAREST_VOXELS**2:
                has |= 1 << int((math.atan2(y, x) / (2 * math.pi) + 0.5) * SECTORS) % SECTORS
        goes_on[k] = has == (1 << SECTORS) - 1
    return goes_on
