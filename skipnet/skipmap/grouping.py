"""Which of many points share a voxel: a hash table of packed cells, in one pass, without a sort."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import FloatArray, IntArray

BITS = 21
"""Of a packed key for each of x, y and z, from the top down."""
CELL_OFFSET = 1 << (BITS - 1)
"""Added to each index before it is packed."""
CELL_MIN, CELL_MAX = -CELL_OFFSET, CELL_OFFSET - 1
"""The smallest and the largest index that a packed cell can hold."""
NO_ROWS = np.empty(0, dtype=np.int32)
"""For whoever does not ask which group each one is in."""

_EMPTY = -1
_MOST_BITS_AT_FIRST = 16
"""Scans of any size have some tens of thousands of voxels: room for so many is made at once."""
_GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)
"""2^64 over the golden ratio, as a signed number: the upper bits of its products with keys are
spread evenly."""


def group_points(points_m: FloatArray, T_cells_points: FloatArray, row: IntArray) -> IntArray:
    """Find the distinct cells of points.

    Args:
        points_m: (N, 3) points.
        T_cells_points: (4, 4) affine, to coordinates of which the floors are cells.
        row: (N,) is filled with the number of each point's cell; or empty, and stays so.

    Returns:
        (G,) packed keys in order of appearance; none if a point lies beyond what they can hold.
    """
    distinct, start = _Distinct(len(points_m)), 0
    while 0 <= start < len(points_m):
        distinct.make_room()
        start, distinct.count = _group_points(
            points_m, start, T_cells_points, distinct.slots, distinct.keys, distinct.count, row
        )
    return distinct.keys[: distinct.count if start >= 0 else 0]


def group_keys(keys: IntArray) -> tuple[IntArray, IntArray]:
    """(G,) distinct ones of (N,) packed keys, ascending, and the (N,) int32 row of each key.

    What ``np.unique`` does, without a sort of them all.
    """
    row = np.empty(len(keys), dtype=np.int32)
    return sort_groups(distinct_keys(keys, row), row), row


def distinct_keys(keys: IntArray, row: IntArray) -> IntArray:
    """(G,) distinct ones of (N,) packed keys; order and ``row`` are as in ``group_points``."""
    distinct, start = _Distinct(len(keys)), 0
    while start < len(keys):
        distinct.make_room()
        start, distinct.count = _group_keys(
            keys, start, distinct.slots, distinct.keys, distinct.count, row
        )
    return distinct.keys[: distinct.count]


def sort_groups(keys: IntArray, row: IntArray) -> IntArray:
    """(G,) distinct keys, ascending; (N,) rows among them are changed in place."""
    order = np.argsort(keys)
    rank = np.empty(len(keys), dtype=np.int32)
    rank[order] = np.arange(len(keys), dtype=np.int32)
    _renumber(row, rank)
    return keys[order]


class _Distinct:
    """Distinct keys in order of appearance, and a hash table that leads to them and grows."""

    def __init__(self, keys: int) -> None:
        """For so many keys, of which some may be equal."""
        self.count = 0
        self.keys = np.empty(1 << min(keys.bit_length(), _MOST_BITS_AT_FIRST), dtype=np.int64)
        self.slots = np.full(2 * len(self.keys), _EMPTY, dtype=np.int32)

    def make_room(self) -> None:
        """Grow to twice the size when full."""
        if self.count == len(self.keys):
            self.slots = np.full(2 * len(self.slots), _EMPTY, dtype=np.int32)
            _fill_slots(self.keys, self.slots)
            self.keys = np.concatenate([self.keys, np.empty_like(self.keys)])


@compiled
def _slot_of(key: int, slots: IntArray, distinct: IntArray) -> int:
    """The slot that holds the number of a key, or the empty one where it would go."""
    spread = key * _GOLDEN  # its upper bits depend on all of the key's
    mask = len(slots) - 1
    slot = ((spread >> 36) ^ (spread >> 50)) & mask
    while slots[slot] != _EMPTY and distinct[slots[slot]] != key:
        slot = (slot + 1) & mask
    return slot


@compiled
def _fill_slots(distinct: IntArray, slots: IntArray) -> None:
    """Put the numbers of all keys into empty slots."""
    for number in range(len(distinct)):
        slots[_slot_of(distinct[number], slots, distinct)] = number


@compiled
def _group_points(
    points_m: FloatArray,
    start: int,
    T_cells_points: FloatArray,
    slots: IntArray,
    distinct: IntArray,
    count: int,
    row: IntArray,
) -> tuple[int, int]:
    """Go on from a point with ``count`` distinct keys, until these are full or the points all done.

    Returns:
        Where it stopped, -1 at a point that lies beyond what a key can hold; and the new count.
    """
    before, own = -1, 0
    T = T_cells_points
    for i in range(start, len(points_m)):
        x_m, y_m, z_m = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        x = np.floor(T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3])
        y = np.floor(T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3])
        z = np.floor(T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3])
        if not (
            CELL_MIN <= x <= CELL_MAX and CELL_MIN <= y <= CELL_MAX and CELL_MIN <= z <= CELL_MAX
        ):
            return -1, count
        key = (
            ((int(x) + CELL_OFFSET) << (2 * BITS))
            | ((int(y) + CELL_OFFSET) << BITS)
            | (int(z) + CELL_OFFSET)
        )
        if key != before:  # a scan's points come in lines: often the cell is that of the last
            slot = _slot_of(key, slots, distinct)
            if slots[slot] == _EMPTY:
                if count == len(distinct):
                    return i, count
                slots[slot], distinct[count] = count, key
                count += 1
            before, own = key, slots[slot]
        if len(row):
            row[i] = own
    return len(points_m), count


@compiled
def _group_keys(
    keys: IntArray, start: int, slots: IntArray, distinct: IntArray, count: int, row: IntArray
) -> tuple[int, int]:
    """As ``_group_points``, for keys."""
    for i in range(start, len(keys)):
        slot = _slot_of(keys[i], slots, distinct)
        if slots[slot] == _EMPTY:
            if count == len(distinct):
                return i, count
            slots[slot], distinct[count] = count, keys[i]
            count += 1
        if len(row):
            row[i] = slots[slot]
    return len(keys), count


@compiled
def _renumber(row: IntArray, rank: IntArray) -> None:
    """Replace each row by its rank."""
    for i in range(len(row)):
        row[i] = rank[row[i]]
