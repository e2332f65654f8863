"""Which voxel is in a cell, or next to it, for millions of places at once."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled, inlined
from skipnet.types import FloatArray, IntArray

_LEAF_BITS = 2
_BLOCK_BITS = 4
"""Cells along each edge, as powers of two: leaves of 4, and blocks of 16."""
_LEAVES_BITS = _BLOCK_BITS - _LEAF_BITS
_MOST_BLOCKS = 1 << 22
"""Blocks that the table may span, most of them empty: 2500 cells in each direction."""
_COUNT_ONLY = np.empty((2, 0), dtype=np.int32)
_STEP_BITS = 2
"""A cell holds the row of its voxel and how many steps away that is, 0 to 3."""


class CellTable:
    """The row of the voxel in each cell, or next to it.

    Three tables behind each other: blocks of the box around all voxels, leaves of a block, cells of
    a leaf. Where there is nothing, all lead to one empty block and one empty leaf: a lookup decides
    nothing on the way, so that even places in no order take few nanoseconds, and the tables take
    little memory however far the voxels spread.
    """

    def __init__(
        self,
        cells: IntArray,
        voxel_size_m: float,
        origin_m: FloatArray,
        with_neighbours: bool = False,
    ) -> None:
        """Index voxels by cell.

        Args:
            cells: (V, 3) distinct cells. Those that lie so far away that a table around them all
                would be too large are left out.
            voxel_size_m: edge of a cell.
            origin_m: (3,) corner of cell (0, 0, 0).
            with_neighbours: the 26 cells around a voxel lead to it too; where several could, to one
                that is fewest steps away.
        """
        self.voxel_size_m, self.origin_m = voxel_size_m, origin_m
        low, blocks = _box(cells)
        self._low = low << _BLOCK_BITS
        cells = np.ascontiguousarray(cells - self._low)
        reach = int(with_neighbours)
        top = np.zeros(tuple(blocks), dtype=np.int32)
        leaves_of = np.zeros(
            (1 + _add_blocks(cells, reach, top), 1 << (3 * _LEAVES_BITS)), np.int32
        )
        leaves = 1 + _add_leaves(cells, reach, top, leaves_of)
        rows = np.full((leaves, 1 << (3 * _LEAF_BITS)), -1, dtype=np.int32)
        self._tables = top, leaves_of, rows
        _fill_leaves(cells, reach, *self._tables)

    def find(self, cells: IntArray) -> IntArray:
        """The row for each (..., 3) cell, int32; -1 for none."""
        nowhere_else = np.zeros((1, 3), dtype=np.int64)
        return self.find_around(cells.reshape(-1, 3), nowhere_else).reshape(cells.shape[:-1])

    def find_around(self, cells: IntArray, steps: IntArray) -> IntArray:
        """(K, O) int32 rows for what is (O, 3) steps from each of (K, 3) cells; -1 for none."""
        cells = np.ascontiguousarray(cells - self._low)
        found = np.empty((len(cells), len(steps)), dtype=np.int32)
        _find_around(cells, steps, *self._tables, found)
        return found

    def find_moved(
        self, T_table_points: FloatArray, points_m: FloatArray, samples: int | None = None
    ) -> IntArray:
        """The row where each motion puts each point.

        Args:
            T_table_points: (C, 4, 4) motions into the table's frame.
            points_m: (V, 3) points; the computation has their precision.
            samples: the first so many of the points alone.

        Returns:
            (C, S) int32; -1 for none.
        """
        T_cells_points = np.array(T_table_points[:, :3])
        T_cells_points[:, :, 3] -= self.origin_m
        T_cells_points *= 1 / self.voxel_size_m
        T_cells_points[:, :, 3] -= self._low
        T_cells_points = T_cells_points.astype(points_m.dtype)
        found = np.empty((len(T_table_points), len(points_m[:samples])), dtype=np.int32)
        _find_moved(T_cells_points, points_m, *self._tables, found)
        return found

    def find_along(
        self,
        starts_m: FloatArray,
        ways: FloatArray,
        first_m: float,
        ends_m: FloatArray,
        step_m: float,
    ) -> tuple[IntArray, IntArray]:
        """The voxels that straight lines meet.

        Args:
            starts_m: (L, 3) where lines start.
            ways: (L, 3) their unit directions.
            first_m: where along the lines to start looking ...
            ends_m: (L,) ... and where to stop.
            step_m: from one look to the next.

        Returns:
            (P,) which line met (P,) which row, in order; once for several looks on end.
        """
        looks = np.maximum(np.ceil((ends_m - first_m) / step_m), 0).astype(np.int64)
        starts = (starts_m + first_m * ways - self.origin_m) * (1 / self.voxel_size_m) - self._low
        strides = ways * (step_m / self.voxel_size_m)
        lines = starts, strides, looks
        met = np.empty((2, _find_along(*lines, *self._tables, _COUNT_ONLY)), dtype=np.int32)
        _find_along(*lines, *self._tables, met)
        return met[0], met[1]


def _box(cells: IntArray) -> tuple[IntArray, IntArray]:
    """(3,) lowest block, and (3,) how many there are along each axis, of a box with room for all
    cells, their neighbours and an empty cell at every face; where that is too large, its middle."""
    if len(cells) == 0:
        return np.zeros(3, dtype=np.int64), np.ones(3, dtype=np.int64)
    low, high = ((end >> _BLOCK_BITS) for end in (cells.min(axis=0) - 2, cells.max(axis=0) + 2))
    blocks = high - low + 1
    middle = np.median(cells, axis=0).astype(np.int64) >> _BLOCK_BITS
    while np.prod(blocks, dtype=float) > _MOST_BLOCKS:
        half = blocks.max() // 4
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)
        blocks = high - low + 1
    return low, blocks


@compiled
def _is_inside(cells: IntArray, v: int, top: IntArray) -> bool:
    """Whether a cell and its neighbours are not at a face of the box."""
    is_inside = True
    for axis in range(3):
        is_inside &= 2 <= cells[v, axis] < (top.shape[axis] << _BLOCK_BITS) - 2
    return is_inside


@compiled
def _add_blocks(cells: IntArray, reach: int, top: IntArray) -> int:
    """Number the blocks with cells within ``reach`` of some, from 1; returns how many there are."""
    count = 0
    for v in range(len(cells)):
        if _is_inside(cells, v, top):
            own_x, own_y, own_z = cells[v, 0], cells[v, 1], cells[v, 2]
            for x in range((own_x - reach) >> _BLOCK_BITS, ((own_x + reach) >> _BLOCK_BITS) + 1):
                for y in range(
                    (own_y - reach) >> _BLOCK_BITS, ((own_y + reach) >> _BLOCK_BITS) + 1
                ):
                    for z in range(
                        (own_z - reach) >> _BLOCK_BITS, ((own_z + reach) >> _BLOCK_BITS) + 1
                    ):
                        if top[x, y, z] == 0:
                            count += 1
                            top[x, y, z] = count
    return count


@inlined
def _place(x: int, y: int, z: int, from_bits: int, bits: int) -> int:
    """The number, in its block of 2^bits along each edge, of what is 2^from_bits cells long."""
    mask = (1 << bits) - 1
    x, y, z = (x >> from_bits) & mask, (y >> from_bits) & mask, (z >> from_bits) & mask
    return (x << (2 * bits)) | (y << bits) | z


@compiled
def _add_leaves(cells: IntArray, reach: int, top: IntArray, leaves_of: IntArray) -> int:
    """As ``_add_blocks``, for the leaves in the blocks."""
    count = 0
    for v in range(len(cells)):
        if _is_inside(cells, v, top):
            own_x, own_y, own_z = cells[v, 0], cells[v, 1], cells[v, 2]
            for x in range((own_x - reach) >> _LEAF_BITS, ((own_x + reach) >> _LEAF_BITS) + 1):
                for y in range((own_y - reach) >> _LEAF_BITS, ((own_y + reach) >> _LEAF_BITS) + 1):
                    for z in range(
                        (own_z - reach) >> _LEAF_BITS, ((own_z + reach) >> _LEAF_BITS) + 1
                    ):
                        block = top[x >> _LEAVES_BITS, y >> _LEAVES_BITS, z >> _LEAVES_BITS]
                        place = _place(x, y, z, 0, _LEAVES_BITS)
                        if leaves_of[block, place] == 0:
                            count += 1
                            leaves_of[block, place] = count
    return count


@compiled
def _fill_leaves(
    cells: IntArray, reach: int, top: IntArray, leaves_of: IntArray, rows: IntArray
) -> None:
    """Write each row into its voxel's cell, and into those within ``reach`` that have none nearer,
    together with the number of steps to there."""
    for v in range(len(cells)):
        if _is_inside(cells, v, top):
            own_x, own_y, own_z = cells[v, 0], cells[v, 1], cells[v, 2]
            for x in range(own_x - reach, own_x + reach + 1):
                for y in range(own_y - reach, own_y + reach + 1):
                    for z in range(own_z - reach, own_z + reach + 1):
                        steps = abs(x - own_x) + abs(y - own_y) + abs(z - own_z)
                        block = top[x >> _BLOCK_BITS, y >> _BLOCK_BITS, z >> _BLOCK_BITS]
                        leaf = leaves_of[block, _place(x, y, z, _LEAF_BITS, _LEAVES_BITS)]
                        place = _place(x, y, z, 0, _LEAF_BITS)
                        there = rows[leaf, place]
                        if there < 0 or (there & ((1 << _STEP_BITS) - 1)) > steps:
                            rows[leaf, place] = v << _STEP_BITS | steps


@inlined
def _row_at(x: int, y: int, z: int, top: IntArray, leaves_of: IntArray, rows: IntArray) -> int:
    """The row for a cell of the box, -1 for none; cells beyond a face count as the one there."""
    x = min(max(x, 0), (top.shape[0] << _BLOCK_BITS) - 1)
    y = min(max(y, 0), (top.shape[1] << _BLOCK_BITS) - 1)
    z = min(max(z, 0), (top.shape[2] << _BLOCK_BITS) - 1)
    block = top[x >> _BLOCK_BITS, y >> _BLOCK_BITS, z >> _BLOCK_BITS]
    leaf = leaves_of[block, _place(x, y, z, _LEAF_BITS, _LEAVES_BITS)]
    return rows[leaf, _place(x, y, z, 0, _LEAF_BITS)] >> _STEP_BITS


@inlined
def _cell(place: float) -> int:
    """Of a coordinate in cells of the box; what is far out, or NaN, is out, and fits an integer."""
    return int(min(1e9, max(-1.0, place)) + 1.0) - 1


@compiled
def _find_around(
    cells: IntArray,
    steps: IntArray,
    top: IntArray,
    leaves_of: IntArray,
    rows: IntArray,
    found: IntArray,
) -> None:
    """See ``CellTable.find_around``."""
    for k in range(len(cells)):
        for o in range(len(steps)):
            found[k, o] = _row_at(
                cells[k, 0] + steps[o, 0],
                cells[k, 1] + steps[o, 1],
                cells[k, 2] + steps[o, 2],
                top,
                leaves_of,
                rows,
            )


@compiled
def _find_moved(
    T_cells_points: FloatArray,
    points_m: FloatArray,
    top: IntArray,
    leaves_of: IntArray,
    rows: IntArray,
    found: IntArray,
) -> None:
    """See ``CellTable.find_moved``."""
    for c in range(len(T_cells_points)):
        T = T_cells_points[c]
        for s in range(found.shape[1]):
            x, y, z = points_m[s, 0], points_m[s, 1], points_m[s, 2]
            found[c, s] = _row_at(
                _cell(T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]),
                _cell(T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]),
                _cell(T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]),
                top,
                leaves_of,
                rows,
            )


@compiled
def _find_along(
    starts: FloatArray,
    strides: FloatArray,
    looks: IntArray,
    top: IntArray,
    leaves_of: IntArray,
    rows: IntArray,
    met: IntArray,
) -> int:
    """See ``CellTable.find_along``; coordinates in cells. Returns how many were met, and writes
    them down where there is room."""
    count = 0
    for line in range(len(starts)):
        last = -1
        for look in range(looks[line]):
            row = _row_at(
                _cell(starts[line, 0] + look * strides[line, 0]),
                _cell(starts[line, 1] + look * strides[line, 1]),
                _cell(starts[line, 2] + look * strides[line, 2]),
                top,
                leaves_of,
                rows,
            )
            if row >= 0 and row != last:
                if met.shape[1]:
                    met[0, count], met[1, count] = line, row
                count += 1
            last = row
    return count
