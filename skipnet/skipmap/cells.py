"""Integer cells of a voxel grid: packing three indices into one sortable key, and finding keys fast."""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray, IntArray

_BITS = 21
_OFFSET = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1
CELL_MIN, CELL_MAX = -_OFFSET, _OFFSET - 1
"""The smallest and the largest index that a packed cell can hold."""
_EMPTY = np.int64(-1)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def cells_of(points_m: FloatArray, voxel_size_m: float, origin_m: FloatArray) -> IntArray:
    """The (..., 3) int64 cell that holds each point: floor((p - origin) / voxel size).

    Raises:
        ValueError: a point lies more than 2^20 voxels from the origin.
    """
    cells = np.floor((points_m - origin_m) * (1.0 / voxel_size_m)).astype(np.int64)
    if cells.size and (cells.min() < -_OFFSET or cells.max() >= _OFFSET):
        raise ValueError(
            f"points reach more than {_OFFSET} voxels of {voxel_size_m:g} m from the origin; "
            "remove far outliers or choose a larger voxel_size_m"
        )
    return cells


def pack(cells: IntArray) -> IntArray:
    """One non-negative int64 key per (..., 3) cell; keys sort by x, then y, then z (the skip-tree's order)."""
    x, y, z = (cells[..., axis].astype(np.int64) + _OFFSET for axis in range(3))
    return (x << (2 * _BITS)) | (y << _BITS) | z


def unpack(keys: IntArray) -> IntArray:
    """The (..., 3) int64 cells of packed keys; the inverse of ``pack``.

    >>> unpack(pack(np.array([[1, -2, 3]])))
    array([[ 1, -2,  3]])
    """
    axes = (keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK)
    return np.stack(axes, axis=-1) - _OFFSET


class CellIndex:
    """Exact lookup of packed keys in an open-addressing hash table, vectorised over the queries.

    About four times faster than a binary search in the sorted keys, and the verifier asks for a
    million cells per registration.
    """

    def __init__(self, keys: IntArray, values: IntArray | None = None) -> None:
        """Build the table over (V,) distinct keys; ``values`` defaults to their positions."""
        slots = 1 << max(4, int(np.ceil(np.log2(max(1, len(keys)) * 4))))
        self._shift = np.uint64(64 - int(np.log2(slots)))
        self._slot_mask = slots - 1
        self._keys = np.full(slots, _EMPTY)
        self._values = np.full(slots, -1, dtype=np.int32)
        if values is None:
            values = np.arange(len(keys))
        self._insert(np.asarray(keys, dtype=np.int64), values.astype(np.int32))

    def _slot(self, keys: IntArray) -> IntArray:
        return ((keys.astype(np.uint64) * _GOLDEN) >> self._shift).astype(np.int64)

    def _insert(self, keys: IntArray, values: IntArray) -> None:
        slot = self._slot(keys)
        while len(keys):
            free = self._keys[slot] == _EMPTY
            self._keys[slot[free]] = keys[free]  # of several on one slot the last one stays
            placed = self._keys[slot] == keys
            self._values[slot[placed]] = values[placed]
            keys, values, slot = keys[~placed], values[~placed], (slot[~placed] + 1) & self._slot_mask

    def find(self, keys: IntArray) -> IntArray:
        """The value stored for each key, int32 of the keys' shape; -1 where the key is absent."""
        flat = keys.ravel()
        slot = self._slot(flat)
        there = self._keys[slot]
        found = np.where(there == flat, self._values[slot], np.int32(-1))
        pending = np.flatnonzero((there != flat) & (there != _EMPTY))
        slot = slot[pending]
        while len(pending):
            slot = (slot + 1) & self._slot_mask
            there = self._keys[slot]
            hit = there == flat[pending]
            found[pending[hit]] = self._values[slot[hit]]
            going_on = ~hit & (there != _EMPTY)
            pending, slot = pending[going_on], slot[going_on]
        return found.reshape(keys.shape)
