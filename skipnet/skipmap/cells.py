"""Integer cells of a voxel grid: three indices in one sortable key, and finding keys fast."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skipnet.types import FloatArray, IntArray

_BITS = 21
_OFFSET = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1
CELL_MIN, CELL_MAX = -_OFFSET, _OFFSET - 1
"""The smallest and the largest index that a packed cell can hold."""
POINTS_AT_ONCE = 1 << 18
"""Points to group by cell in one go: far more than there are cells, and some 20 MB on the way."""
_LARGEST_TABLE = 1 << 23
"""Entries that a table over a box of cells may have where the other way is to sort the points."""
_LARGEST_SMALL_TABLE = 1 << 22
"""Likewise, where the other way is a hash table over the voxels."""
_CELLS_AT_ONCE = 1 << 13
"""Cells whose neighbours are looked up in one go, in memory that is still at hand from the last."""
_FIELDS = (1 << (2 * _BITS)) + (1 << _BITS) + 1
"""A one in each of a key's three fields."""
_LOW_BITS = _FIELDS * (_MASK >> 1)
_HALF_OFFSETS = _FIELDS * (_OFFSET >> 1)
_EMPTY = np.int64(-1)
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def cells_of(points_m: FloatArray, voxel_size_m: float, origin_m: FloatArray) -> IntArray:
    """The (..., 3) int32 cell that holds each point: floor((p - origin) / voxel size).

    Raises:
        ValueError: a point lies more than 2^20 voxels from the origin.
    """
    scaled = points_m - origin_m
    scaled *= 1.0 / voxel_size_m
    return _to_cells(scaled, voxel_size_m)


def _to_cells(scaled: FloatArray, voxel_size_m: float) -> IntArray:
    """Floor of coordinates in voxels, in int32; ``scaled`` is used up."""
    np.floor(scaled, out=scaled)
    if scaled.size and not (scaled.min() >= CELL_MIN and scaled.max() <= CELL_MAX):
        raise ValueError(
            f"points reach more than {_OFFSET} voxels of {voxel_size_m:g} m from the origin; "
            "remove far outliers or choose a larger voxel_size_m"
        )
    return scaled.astype(np.int32)


def pack(cells: IntArray) -> IntArray:
    """One non-negative int64 key per (..., 3) cell; keys sort by x, then y, then z."""
    x, y, z = (cells[..., axis].astype(np.int64) + _OFFSET for axis in range(3))
    return (x << (2 * _BITS)) | (y << _BITS) | z


def unpack(keys: IntArray) -> IntArray:
    """The (..., 3) int64 cells of packed keys; the inverse of ``pack``.

    Axis by axis in memory: whatever is done to all cells is several times faster that way.

    >>> unpack(pack(np.array([[1, -2, 3]])))
    array([[ 1, -2,  3]])
    """
    axes = (keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK)
    return np.moveaxis(np.stack(axes) - _OFFSET, 0, -1)


def halve(keys: IntArray) -> IntArray:
    """Keys of the cells twice as wide that hold (V,) cells: ``pack(unpack(keys) >> 1)``, quickly.

    >>> unpack(halve(pack(np.array([[5, -1, -4]]))))
    array([[ 2, -1, -2]])
    """
    return ((keys >> 1) & _LOW_BITS) + _HALF_OFFSETS


@dataclass(frozen=True)
class _Box:
    """A block of cells, numbered by x, then y, then z: numbers sort as packed keys do."""

    low: IntArray
    """(3,) smallest cell."""
    shape: IntArray
    """(3,) cells along each axis."""

    @staticmethod
    def around(cells: IntArray, margin: IntArray | int = 0) -> _Box:
        """The smallest box with (3, N) cells and ``margin`` more on every side."""
        low = cells.min(axis=1).astype(np.int64) - margin
        return _Box(low, cells.max(axis=1) + margin - low + 1)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(int(length) for length in self.shape)

    @property
    def strides(self) -> IntArray:
        """(3,) by how much a step along each axis changes a cell's number."""
        return np.array([self.shape[1] * self.shape[2], self.shape[2], 1])

    def number(self, cells: IntArray) -> IntArray:
        """(N,) int32 numbers of (3, N) cells in a box of less than 2^31."""
        x, y, z = (cells[axis].astype(np.int32) - np.int32(self.low[axis]) for axis in range(3))
        x *= np.int32(self.shape[1])
        x += y
        x *= np.int32(self.shape[2])
        x += z
        return x

    def occupied(self, number: IntArray) -> IntArray:
        """The distinct ones of (N,) numbers, ascending."""
        there = np.zeros(self.size, dtype=bool)
        there[number] = True
        return np.flatnonzero(there)

    def cells(self, numbers: IntArray) -> IntArray:
        """(N, 3) int64 cells of numbers; the inverse of ``number``."""
        columns, z = np.divmod(numbers, self.shape[2])
        x, y = np.divmod(columns, self.shape[1])
        return (np.stack([x, y, z]) + self.low[:, None]).T


def group_by_cell(xyz_m: FloatArray, voxel_size_m: float) -> tuple[IntArray, IntArray]:
    """Which points share a cell of a grid with a corner at the origin.

    A table over the points' bounding box takes the place of a sort, where it is not too large.

    Args:
        xyz_m: (3, N) coordinates.
        voxel_size_m: edge of a cell.

    Returns:
        (G,) packed keys of the occupied cells, ascending, and the (N,) row among them that holds
        each point.

    Raises:
        ValueError: as ``cells_of``.
    """
    cells = _to_cells(xyz_m * (1.0 / voxel_size_m), voxel_size_m)
    box = _Box.around(cells)
    if box.size > _LARGEST_TABLE:
        return np.unique(pack(cells.T), return_inverse=True)
    number = box.number(cells)
    numbers = box.occupied(number)
    row_of = np.empty(box.size, dtype=np.int32)
    row_of[numbers] = np.arange(len(numbers), dtype=np.int32)
    return pack(box.cells(numbers)), row_of.take(number)


def occupied_cells(xyz_m: FloatArray, voxel_size_m: float) -> IntArray:
    """The (3, G) cells of the grid of ``group_by_cell`` that hold some of (3, N) points."""
    return distinct_cells(_to_cells(xyz_m * (1.0 / voxel_size_m), voxel_size_m))


def distinct_cells(cells: IntArray) -> IntArray:
    """The distinct ones of (3, N) cells, (3, G), sorted by x, then y, then z.

    >>> distinct_cells(np.array([[2, 0, 2], [0, 1, 0], [0, 0, 0]]))
    array([[0, 2],
           [1, 0],
           [0, 0]])
    """
    box = _Box.around(cells)
    if box.size > _LARGEST_TABLE:
        return unpack(np.unique(pack(cells.T))).T
    return box.cells(box.occupied(box.number(cells))).T


def neighbour_rows(keys: IntArray, offsets: IntArray) -> tuple[IntArray, IntArray]:
    """The neighbours of every cell among the same cells, as SciPy's compressed rows have them.

    Args:
        keys: (V,) distinct packed cells.
        offsets: (K, 3) steps from a cell to its neighbours, 127 at most.

    Returns:
        (P,) int32 rows of ``keys``, of each cell the neighbours that exist in the offsets' order,
        and (V + 1,) where those of each cell start and end.
    """
    if len(keys) == 0:
        return np.zeros(0, dtype=np.int32), np.zeros(1, dtype=np.intp)
    find = _neighbour_finder(keys, offsets)
    found, counts = [], [np.zeros(1, dtype=np.int8)]
    for start in range(0, len(keys), _CELLS_AT_ONCE):
        near = find(slice(start, start + _CELLS_AT_ONCE))
        there = near >= 0
        found.append(near.ravel().take(np.flatnonzero(there)))
        counts.append(np.einsum("vk->v", there.view(np.int8)))  # three times as fast as sum()
    return np.concatenate(found), np.cumsum(np.concatenate(counts), dtype=np.intp)


def _neighbour_finder(keys: IntArray, offsets: IntArray) -> Callable[[slice], IntArray]:
    """What tells the (B, K) int32 rows of some cells' neighbours; -1 where there is none."""
    cells = unpack(keys).T.astype(np.int32)
    box = _Box.around(cells, np.abs(offsets).max(axis=0))
    if box.size > _LARGEST_SMALL_TABLE:
        index, shifts = CellIndex(keys), pack(offsets) - pack(np.zeros(3, np.int64))
        return lambda rows: index.find(keys[rows, None] + shifts)
    number = box.number(cells).astype(np.intp)
    row_of = np.full(box.size, -1, dtype=np.int32)
    row_of[number] = np.arange(len(keys), dtype=np.int32)
    steps = offsets @ box.strides
    # The margin keeps all inside; clip checks nothing.
    return lambda rows: row_of.take(number[rows, None] + steps, mode="clip")


class CellIndex:
    """Exact lookup of packed keys in an open-addressing hash table, vectorised over the queries.

    About four times faster than a binary search in the sorted keys, and the verifier asks for a
    million cells per registration.
    """

    def __init__(self, keys: IntArray, values: IntArray | None = None) -> None:
        """Build the table over (V,) distinct keys; ``values`` default to their positions."""
        self._allocate(len(keys))
        self.insert(keys, np.arange(len(keys)) if values is None else values)

    def _allocate(self, keys: int) -> None:
        bits = max(4, int(np.ceil(np.log2(max(1, keys) * 3))))
        self._shift = np.uint64(64 - bits)
        self._slot_mask = (1 << bits) - 1
        self._keys = np.full(1 << bits, _EMPTY)
        self._values = np.full(1 << bits, -1, dtype=np.int32)
        self._used = 0

    def _slot(self, keys: IntArray) -> IntArray:
        return ((keys.astype(np.uint64) * _GOLDEN) >> self._shift).astype(np.int64)

    def insert(self, keys: IntArray, values: IntArray) -> None:
        """Add (V,) distinct keys; one that is there already keeps its value."""
        if 2 * (self._used + len(keys)) > len(self._keys):
            there, kept = self._keys != _EMPTY, (self._keys, self._values)
            self._allocate(2 * (self._used + len(keys)))
            self.insert(kept[0][there], kept[1][there])
        slot = self._slot(keys)
        values = values.astype(np.int32)
        while len(keys):
            there = self._keys[slot]
            free = there == _EMPTY
            self._keys[slot[free]] = keys[free]  # of several on one slot the last one stays
            placed = free & (self._keys[slot] == keys)
            self._values[slot[placed]] = values[placed]
            self._used += int(placed.sum())
            left = ~placed & (there != keys)
            keys, values, slot = keys[left], values[left], (slot[left] + 1) & self._slot_mask

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
