"""Which voxel is in a cell, or next to it, for millions of places at once."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled, inlined
from skipnet.types import FloatArray, IntArray

_BITS = 2
_SIDE = 1 << _BITS
"""Cells along each edge of a block."""
_MOST_PLACES = 1 << 20
"""For blocks: those that lie farther apart than there are places share them."""
_END = 1 << 22
"""No cell lies there, nor beyond."""
_KEY_BITS = 21
"""Of a block's key for each of x, y and z."""
_STEP_BITS = 2
"""A cell holds the row of its voxel and how many steps away that is, 0 to 3."""
_USUALLY_MET = 32
"""Voxels that a line meets, at most; where lines meet more they are walked twice."""

_Blocks = tuple[IntArray, IntArray, IntArray]
"""(X, Y, Z) the first block at each place, 0 for none; (B,) keys, and (B,) the next block at the
same place. Block 0 is empty."""
_Tables = tuple[_Blocks, IntArray]
"""Blocks, and the (B, 64) rows of each."""


class CellTable:
    """The row of the voxel in each cell, or next to it.

    A table of blocks leads to tables of their cells. Where there is nothing it leads to one empty
    block: a lookup decides next to nothing on the way, so that even places in no order take few
    nanoseconds. Blocks are found by the lower bits of their indices, and those with equal ones one
    after the other, so the tables take little memory however far the voxels spread.
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
            cells: (V, 3) distinct cells.
            voxel_size_m: edge of a cell.
            origin_m: (3,) corner of cell (0, 0, 0).
            with_neighbours: the 26 cells around a voxel lead to it too; where several could, to one
                that is fewest steps away.
        """
        self.voxel_size_m, self.origin_m = voxel_size_m, origin_m
        reach = int(with_neighbours)
        self._lowest, places = _places_for_blocks(cells, reach)  # faster while axis by axis
        cells = np.ascontiguousarray(cells)
        first = np.zeros(places, dtype=np.int32)
        keys, following = np.zeros((2, 1024), dtype=np.int64)
        start, count = 0, 1
        while start < len(cells):
            if start > 0:  # there was no room for more
                keys, following = (np.tile(part, 2) for part in (keys, following))
            start, count = _add_blocks(cells, start, reach, (first, keys, following), count)
        rows = np.full((count, _SIDE**3), -1, dtype=np.int32)
        self._tables: _Tables = (first, keys, following), rows
        _fill_blocks(cells, reach, self._tables)

    def find(self, cells: IntArray) -> IntArray:
        """The row for each (..., 3) cell, int32; -1 for none."""
        there = np.zeros((1, 3), dtype=np.int64)
        return self.find_around(cells.reshape(-1, 3), there).reshape(cells.shape[:-1])

    def find_around(self, cells: IntArray, steps: IntArray) -> IntArray:
        """(K, O) int32 rows for what is (O, 3) steps from each of (K, 3) cells; -1 for none."""
        cells = np.ascontiguousarray(cells, dtype=np.int64)
        found = np.empty((len(cells), len(steps)), dtype=np.int32)
        _find_around(cells, steps, self._tables, found)
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
        T_cells_points = T_cells_points.astype(points_m.dtype)
        points_m = points_m[:samples]
        found = np.empty((len(T_table_points), len(points_m)), dtype=np.int32)
        if self._lowest is None:
            _find_moved(T_cells_points, points_m, self._tables, found)
        else:
            columns_m, places = points_m.T.copy(), np.empty((2, len(points_m)), dtype=np.int32)
            _find_in_box(T_cells_points, columns_m, self._tables, self._lowest, places, found)
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
        starts = (starts_m + first_m * ways - self.origin_m) * (1 / self.voxel_size_m)
        strides = ways * (step_m / self.voxel_size_m)
        lines = starts, strides, looks, self._tables
        met = np.empty((2, _USUALLY_MET * len(looks)), dtype=np.int32)
        count = _find_along(*lines, met)
        if count > met.shape[1]:
            met = np.empty((2, count), dtype=np.int32)
            _find_along(*lines, met)
        return met[0, :count], met[1, :count]


def _places_for_blocks(cells: IntArray, reach: int) -> tuple[IntArray | None, tuple[int, ...]]:
    """Where the lowest of the blocks is, and powers of two: along each axis as many as there are
    blocks. Where that is too much, fewer, and no lowest block: some share a place."""
    if not len(cells):
        return np.zeros(3, dtype=np.int64), (1, 1, 1)
    lowest = (cells.min(axis=0) - reach) >> _BITS
    lengths = ((cells.max(axis=0) + reach) >> _BITS) - lowest + 1
    bits = [int(length - 1).bit_length() for length in lengths]
    is_alone = sum(bits) < int(_MOST_PLACES).bit_length()
    while sum(bits) > int(_MOST_PLACES).bit_length() - 1:
        bits[int(np.argmax(bits))] -= 1
    return (lowest if is_alone else None), tuple(1 << bit for bit in bits)


@inlined
def _key(x: int, y: int, z: int) -> int:
    """Of the block of a cell."""
    return ((x >> _BITS) << (2 * _KEY_BITS)) + ((y >> _BITS) << _KEY_BITS) + (z >> _BITS)


@inlined
def _place_of(x: int, y: int, z: int, first: IntArray) -> tuple[int, int, int]:
    """Where the blocks like that of a cell are."""
    X, Y, Z = first.shape
    return (x >> _BITS) & (X - 1), (y >> _BITS) & (Y - 1), (z >> _BITS) & (Z - 1)


@inlined
def _block_of(x: int, y: int, z: int, blocks: _Blocks) -> int:
    """Number of the block of a cell; 0, which is empty, for none."""
    first, keys, following = blocks
    block, key = first[_place_of(x, y, z, first)], _key(x, y, z)
    # What lies outside comes upon some other block: a step on, then, without a decision.
    block = block if keys[block] == key else following[block]
    while (block != 0) & (keys[block] != key):
        block = following[block]
    return block


@inlined
def _in_block(x: int, y: int, z: int) -> int:
    """A cell's place in its block."""
    mask = _SIDE - 1
    return ((x & mask) << (2 * _BITS)) | ((y & mask) << _BITS) | (z & mask)


@compiled
def _add_blocks(
    cells: IntArray, start: int, reach: int, blocks: _Blocks, count: int
) -> tuple[int, int]:
    """Number the blocks with cells within ``reach`` of some, until there is no room for more.

    Returns:
        The row of the cell where it stopped, and the new count of blocks.
    """
    first, keys, following = blocks
    far = max(2 * reach, 1)  # smaller than a block: it is enough to look at the corners
    for v in range(start, len(cells)):
        if count + 8 > len(keys):
            return v, count
        for x in range(cells[v, 0] - reach, cells[v, 0] + reach + 1, far):
            for y in range(cells[v, 1] - reach, cells[v, 1] + reach + 1, far):
                for z in range(cells[v, 2] - reach, cells[v, 2] + reach + 1, far):
                    if _block_of(x, y, z, blocks) == 0:
                        place = _place_of(x, y, z, first)
                        keys[count], following[count] = _key(x, y, z), first[place]
                        first[place] = count
                        count += 1
    return len(cells), count


@compiled
def _fill_blocks(cells: IntArray, reach: int, tables: _Tables) -> None:
    """Write each row into its voxel's cell, and into those within ``reach`` that have none nearer,
    together with the number of steps to there."""
    blocks, rows = tables
    for v in range(len(cells)):
        own_x, own_y, own_z = cells[v, 0], cells[v, 1], cells[v, 2]
        for x in range(own_x - reach, own_x + reach + 1):
            for y in range(own_y - reach, own_y + reach + 1):
                for z in range(own_z - reach, own_z + reach + 1):
                    steps = abs(x - own_x) + abs(y - own_y) + abs(z - own_z)
                    block, place = _block_of(x, y, z, blocks), _in_block(x, y, z)
                    there = rows[block, place]
                    if there < 0 or (there & ((1 << _STEP_BITS) - 1)) > steps:
                        rows[block, place] = v << _STEP_BITS | steps


@inlined
def _cell(place: float) -> int:
    """Of a coordinate in cells; of what is far out, or NaN, one where nothing is."""
    return int(np.floor(min(_END, max(-_END, place))))


@inlined
def _short_cell(place: float) -> int:
    """As ``_cell``, in 32 bits: of these the processor takes more at a time."""
    return np.int32(_cell(place))  # type: ignore[return-value]


@compiled
def _find_around(cells: IntArray, steps: IntArray, tables: _Tables, found: IntArray) -> None:
    """See ``CellTable.find_around``."""
    blocks, rows = tables
    for k in range(len(cells)):
        for o in range(len(steps)):
            x = min(_END, max(-_END, cells[k, 0] + steps[o, 0]))
            y = min(_END, max(-_END, cells[k, 1] + steps[o, 1]))
            z = min(_END, max(-_END, cells[k, 2] + steps[o, 2]))
            block = _block_of(x, y, z, blocks)
            found[k, o] = rows[block, _in_block(x, y, z)] >> _STEP_BITS


@inlined
def _moved_cell(
    T_cells_points: FloatArray, x_m: float, y_m: float, z_m: float
) -> tuple[int, int, int]:
    """The cell that a point lies in once it is moved."""
    T = T_cells_points
    x = _cell(T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3])
    y = _cell(T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3])
    z = _cell(T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3])
    return x, y, z


@compiled
def _find_moved(
    T_cells_points: FloatArray, points_m: FloatArray, tables: _Tables, found: IntArray
) -> None:
    """See ``CellTable.find_moved``."""
    blocks, rows = tables
    for c in range(len(T_cells_points)):
        T = T_cells_points[c]
        for s in range(found.shape[1]):
            x, y, z = _moved_cell(T, points_m[s, 0], points_m[s, 1], points_m[s, 2])
            block = _block_of(x, y, z, blocks)
            found[c, s] = rows[block, _in_block(x, y, z)] >> _STEP_BITS


@compiled
def _find_in_box(
    T_cells_points: FloatArray,
    columns_m: FloatArray,
    tables: _Tables,
    lowest: IntArray,
    places: IntArray,
    found: IntArray,
) -> None:
    """As ``_find_moved``, of (3, S) coordinates, where every block has a place of its own: no key
    is read. Places are worked out for several points at a time, then looked up."""
    (first, _, _), rows = tables
    X, Y, Z = np.int32(first.shape[0]), np.int32(first.shape[1]), np.int32(first.shape[2])
    low_x, low_y, low_z = np.int32(lowest[0]), np.int32(lowest[1]), np.int32(lowest[2])
    blocks, cells = first.ravel(), rows.ravel()
    place, in_block = places[0], places[1]
    xs_m, ys_m, zs_m = columns_m[0], columns_m[1], columns_m[2]
    for c in range(len(T_cells_points)):
        T = T_cells_points[c]
        # Numbers of their own: what is read from an array could change with what is written.
        xx, xy, xz, x0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
        yx, yy, yz, y0 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
        zx, zy, zz, z0 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
        for s in range(len(place)):
            x = _short_cell(xx * xs_m[s] + xy * ys_m[s] + xz * zs_m[s] + x0)
            y = _short_cell(yx * xs_m[s] + yy * ys_m[s] + yz * zs_m[s] + y0)
            z = _short_cell(zx * xs_m[s] + zy * ys_m[s] + zz * zs_m[s] + z0)
            i, j, k = (x >> _BITS) - low_x, (y >> _BITS) - low_y, (z >> _BITS) - low_z
            inside = ((i | j | k) >= 0) & (i < X) & (j < Y) & (k < Z)
            u, v, w = _place_of(x, y, z, first)
            place[s] = (u * Y + v) * Z + w if inside else -1
            in_block[s] = _in_block(x, y, z)
        own = found[c]
        for s in range(len(place)):
            block = blocks[place[s]] if place[s] >= 0 else 0
            own[s] = cells[block * _SIDE**3 + in_block[s]] >> _STEP_BITS


@inlined
def _steps_to_leave(place: float, stride: float) -> float:
    """Of a length, along one axis, to the end of the block that a coordinate is in."""
    low = np.floor(place / _SIDE) * _SIDE
    end = low + _SIDE if stride > 0 else low
    return (end - place) / stride if stride != 0 else float(_END)


@compiled
def _find_along(
    starts: FloatArray, strides: FloatArray, looks: IntArray, tables: _Tables, met: IntArray
) -> int:
    """See ``CellTable.find_along``; coordinates in cells. Returns how many were met, and writes
    them down where there is room."""
    blocks, rows = tables
    count = 0
    for line in range(len(starts)):
        last, look = -1, 0
        while look < looks[line]:
            p_x = starts[line, 0] + look * strides[line, 0]
            p_y = starts[line, 1] + look * strides[line, 1]
            p_z = starts[line, 2] + look * strides[line, 2]
            x, y, z = _cell(p_x), _cell(p_y), _cell(p_z)
            block = _block_of(x, y, z, blocks)
            row = rows[block, _in_block(x, y, z)] >> _STEP_BITS
            if row >= 0 and row != last:
                if count < met.shape[1]:
                    met[0, count], met[1, count] = line, row
                count += 1
            last = row
            if block == 0:  # on to the last look in it
                leave = min(
                    _steps_to_leave(p_x, strides[line, 0]),
                    _steps_to_leave(p_y, strides[line, 1]),
                    _steps_to_leave(p_z, strides[line, 2]),
                )
                look += max(int(min(leave, float(_END))) - 1, 0)
            look += 1
    return count
