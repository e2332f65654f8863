"""Cells that hang together."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import IntArray

_SIDE = (-1, 0, 1)
AROUND = np.array([(x, y, z) for x in _SIDE for y in _SIDE for z in _SIDE if x or y or z])
"""(26, 3) steps from a cell to those around it ..."""
HALF_AROUND = AROUND[len(AROUND) // 2 :]
"""... and to those of them of which each pair of neighbours has one."""
_TWO = range(-2, 3)
WITHIN_TWO = np.array([(x, y, z) for x in _TWO for y in _TWO for z in _TWO])
"""(125, 3) steps from a cell to itself and all within two of it."""


def connected(around: IntArray, rows: IntArray, voxels: int) -> IntArray:
    """(K,) number of the group to which each of (K,) voxels belongs.

    Voxels whose cells touch, be it at a corner, are of one group. Groups are numbered in the order
    of their first voxels.

    Args:
        around: (K, O) rows of what is ``AROUND`` each of them, or ``HALF_AROUND``; -1 for none.
        rows: (K,) theirs; all others are as if they were not there.
        voxels: how many there are in all.
    """
    place = np.full(voxels, -1, dtype=np.int32)
    place[rows] = np.arange(len(rows), dtype=np.int32)
    return _number(around, place)


@compiled
def _number(around: IntArray, place: IntArray) -> IntArray:
    """See ``connected``; (V,) ``place`` says which of the K a voxel is, -1 for none.

    Each voxel leads to one before it in its group, or to itself; groups that touch are joined.
    """
    before = np.arange(len(around))
    for one in range(len(around)):
        first = one
        while before[first] != first:
            first = before[first]
        for o in range(around.shape[1]):
            row = around[one, o]
            other = place[row] if row >= 0 else -1
            if other < 0:
                continue
            while before[other] != other:
                before[other] = before[before[other]]
                other = before[other]
            before[max(first, other)] = min(first, other)
            first = min(first, other)
        before[one] = first
    number = np.empty(len(around), dtype=np.int64)
    groups = 0
    for one in range(len(around)):
        if before[one] == one:
            number[one] = groups
            groups += 1
        else:
            number[one] = number[before[one]]
    return number
