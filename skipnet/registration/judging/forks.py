"""Do two surfaces part? One specimen has a boss where the other one goes on flat.

What one scan shows and the other does not says nothing in itself: the other sensor may not have
seen it. But then the other scan's surface ends there. Where it goes on all the same, another way,
the scans show two things, or one that was changed. That needs no sensor's place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

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
MIN_FACING = 0.65
"""... or where at so much of the rim the other one has a piece of its own, too, within two cells:
where a taller block's sides begin to be there alone, the lower one's top begins. Two views of one
edge share a part of a rim: 0.31 at most under right poses of 100 simulated objects (a real figure:
0.5); of 33 other specimens 26 have more than 0.7."""
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
    T_source_target = invert(T_target_source)
    there = _find_alone(T_target_source, source, target)
    back = _find_alone(T_source_target, target, source)
    yield from _one_way(T_target_source, source, target, there, back)
    for place_m in _one_way(T_source_target, target, source, back, there):
        yield transform_points(T_target_source, place_m[None])[0]


@dataclass(frozen=True)
class _Alone:
    """What a scan's fine level has alone under a pose, and the other one's does not."""

    rows_other: IntArray
    """(V,) the voxel of the other scan at each of its own, -1 for none."""
    rows: IntArray
    """(N,) those without one."""
    around: IntArray
    """(N, O) rows of the voxels about these, -1 for none."""
    number: IntArray
    """(N,) their pieces, touching voxels."""

    def is_of_a_piece(self) -> BoolArray:
        """(V,) which voxels are part of a piece that is large enough to be looked at."""
        is_part = np.zeros(len(self.rows_other), dtype=bool)
        is_part[self.rows] = (np.bincount(self.number) >= FEWEST_VOXELS)[self.number]
        return is_part


def _find_alone(T_b_a: FloatArray, scan_a: Scan, scan_b: Scan) -> _Alone:
    """a's voxels that b has not."""
    a = scan_a.fine_skipmap
    rows_b = scan_b.fine_near.find_moved(T_b_a[None], a.centroids_m)[0]
    rows = np.flatnonzero(rows_b < 0)
    around = a.find_around(rows, AROUND)
    return _Alone(rows_b, rows, around, connected(around, rows, len(a)))


def _one_way(
    T_b_a: FloatArray, scan_a: Scan, scan_b: Scan, alone: _Alone, of_b: _Alone
) -> Iterator[FloatArray]:
    """(3,) middles of a's pieces at which b parts from it, b's frame."""
    a, b, is_of_b = scan_a.fine_skipmap, scan_b.fine_skipmap, of_b.is_of_a_piece()
    for piece in _largest(alone.number):
        rim = alone.around[piece]
        rim = np.unique(alone.rows_other[rim[rim >= 0]])
        rim = rim[rim >= 0]
        if len(rim) < MIN_RIM:
            continue
        rim = rim[_spread(len(rim), MOST_RIM)]
        goes_on = _goes_on(b.find_around(rim, _BALL), rim, b.centroids_m, b.normals, b.voxel_size_m)
        near = b.find_around(rim, WITHIN_TWO)
        faces = ((near >= 0) & is_of_b[near]).any(axis=1)
        points_m = transform_points(T_b_a, a.centroids_m[alone.rows[piece]])
        parts = goes_on.mean() >= MIN_GOING_ON or faces.mean() >= MIN_FACING
        if parts and _is_deep(b, points_m):
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
