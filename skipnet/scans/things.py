"""The small things that stand about in one scan: what lies on a floor, a shelf, or at a wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.primitives import Planes
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.connected import HALF_AROUND, WITHIN_TWO, connected
from skipnet.skipmap.tree import SkipTree
from skipnet.types import BoolArray, FloatArray, IntArray

LARGE_PLANE = 0.02
"""A plane of this share of all voxels is part of the room ..."""
OFF_PLANE_VOXELS = 1.2
"""... and what lies farther off it, in fine voxels, is not part of the plane."""
FURNITURE_PLANE = 0.005
"""A plane of this share may be of the furniture: all seats of a hall, a board of a shelf."""
FEWEST_VOXELS = 5
"""Of a thing, fine ones; it takes up ..."""
MOST_VOXELS = 10
"""... no more than so many of them along each axis of the scan's frame. People, doors and chairs,
which may well move between two scans, are larger."""
MOST_THINGS = 60
"""Of more the largest are looked at: so many tell."""
MIN_DEPTH_VOXELS = 0.4
"""Standard deviation of a bulky thing's voxels across their own plane: what has less may be a
sliver of some larger surface, or of its rim, there again wherever the furniture is the same."""
MIN_FOOTING = 4
"""A thing stands on something if so many voxels of large planes lie within two steps of it: what
hangs in the air is the front of something."""


@dataclass(frozen=True)
class Things:
    """The small things of a scan that stand on its large planes."""

    stands_out: BoolArray
    """(V,) which voxels of the fine tree lie on no large plane."""
    rows: IntArray
    """(N,) voxels of the fine tree that are part of a thing ..."""
    numbers: IntArray
    """(N,) ... and the number of this thing, ascending."""
    is_bulky: BoolArray
    """(T,) which things are no flat pieces."""

    def __len__(self) -> int:
        return len(self.is_bulky)


def standing_out(tree: SkipTree, planes: Planes, least: float) -> BoolArray:
    """(V,) which voxels of a scan lie on none of its large planes.

    Args:
        tree: all its voxels at the finest level.
        planes: of the scan.
        least: voxels of a large plane, of the level at which they were found.
    """
    points_m, out = tree.centroids_m, np.ones(len(tree), dtype=bool)
    large = planes.weights >= least
    for normal, offset_m in zip(planes.normals[large], planes.offsets_m[large], strict=True):
        out &= np.abs(points_m @ normal - offset_m) > OFF_PLANE_VOXELS * tree.voxel_size_m
    return out


def find_things(tree: SkipTree, table: CellTable, out: BoolArray) -> Things:
    """The small things of a scan.

    Args:
        tree: all its voxels at the finest level.
        table: the row of each of their cells.
        out: (V,) which of them stand out, see ``standing_out``.
    """
    cells, rows = tree.cells, np.flatnonzero(out)
    number = connected(table.find_around(cells[rows], HALF_AROUND), rows, len(tree))
    order = np.argsort(number, kind="stable")
    rows, number = rows[order], number[order]
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    if len(starts) == 0:
        return Things(out, rows, number, np.zeros(0, dtype=bool))
    low, high = (part.reduceat(cells[rows], starts) for part in (np.minimum, np.maximum))
    sizes = np.bincount(number)
    sizes[((high - low).max(axis=1) >= MOST_VOXELS) | (sizes < FEWEST_VOXELS)] = 0
    is_small = np.zeros(len(sizes), dtype=bool)
    is_small[np.argsort(-sizes, kind="stable")[:MOST_THINGS]] = True
    is_small &= sizes > 0
    rows, number = rows[is_small[number]], number[is_small[number]]
    footing = footing_of(table.find_around(cells[rows], WITHIN_TWO), number, out, len(starts))
    stands = footing[number] >= MIN_FOOTING
    rows, number = rows[stands], np.unique(number[stands], return_inverse=True)[1]
    depths_m = _depths_m(tree.centroids_m[rows], number)
    return Things(out, rows, number, depths_m >= MIN_DEPTH_VOXELS * tree.voxel_size_m)


def _depths_m(points_m: FloatArray, number: IntArray) -> FloatArray:
    """(G,) standard deviation of each group of (N, 3) points across its own plane, by the (N,)
    numbers of their groups, ascending from 0."""
    if len(number) == 0:
        return np.zeros(0)
    starts, sizes = np.flatnonzero(np.diff(number, prepend=-1)), np.bincount(number)
    away_m = points_m - (np.add.reduceat(points_m, starts) / sizes[:, None])[number]
    spread_m2 = np.add.reduceat(away_m[:, :, None] * away_m[:, None, :], starts)
    across_m2 = np.linalg.eigvalsh(spread_m2 / sizes[:, None, None])[:, 0]
    depths_m: FloatArray = np.sqrt(np.maximum(across_m2, 0.0))
    return depths_m


@compiled
def footing_of(near: IntArray, number: IntArray, out: BoolArray, groups: int) -> IntArray:
    """(G,) how many voxels that do not stand out are near each group's.

    Args:
        near: (N, O) rows of the voxels near each of N, -1 for none.
        number: (N,) their groups, ascending.
        out: (V,) which voxels stand out.
        groups: how many there are.
    """
    footing = np.zeros(groups, dtype=np.int64)
    counted = np.full(len(out), -1, dtype=np.int64)
    for n in range(len(near)):
        for o in range(near.shape[1]):
            row = near[n, o]
            if row >= 0 and not out[row] and counted[row] != number[n]:
                counted[row] = number[n]
                footing[number[n]] += 1
    return footing
