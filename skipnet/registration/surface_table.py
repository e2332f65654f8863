"""Which voxel's surface a point lies on or next to, for millions of points at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.skipmap.cells import CellIndex, pack
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

_LARGEST_BOX = 1 << 23
"""Cells that a plain table may have (32 MB); wider scans take a hash table over the few that
matter."""
_STEPS = np.array(
    sorted(np.ndindex(3, 3, 3), key=lambda cell: int(np.abs(np.subtract(cell, 1)).sum()))
) - np.ones(3, dtype=np.int64)
"""To a cell itself and its 26 neighbours, faces before edges before corners."""
_MARGIN = 2
"""Cells around the scan's box: its neighbours, and an empty one where all that is outside goes."""


@dataclass(frozen=True)
class SurfaceTable:
    """For each cell of effective voxels, or next to one: the row of the voxel fewest steps away."""

    voxel_size_m: float
    corner_m: FloatArray
    """(3,) corner of the table's first cell, scan frame."""
    shape: tuple[int, ...]
    """Cells along each axis."""
    rows: IntArray | CellIndex
    """(cells,) row of each cell, -1 for none; or the same by packed cell."""

    def find(self, x_m: FloatArray, y_m: FloatArray, z_m: FloatArray) -> IntArray:
        """Row of the voxel on or next to which each point lies; -1 where there is none."""
        cells = []
        for axis, coordinate_m in enumerate((x_m, y_m, z_m)):
            cell = coordinate_m - coordinate_m.dtype.type(self.corner_m[axis])
            cell *= coordinate_m.dtype.type(1 / self.voxel_size_m)
            np.clip(cell, 0, self.shape[axis] - 1, out=cell)
            cells.append(cell.astype(np.int32))
        if isinstance(self.rows, CellIndex):
            return self.rows.find(pack(np.stack(cells, axis=-1)))
        _, height, depth = self.shape
        return self.rows.take((cells[0] * np.int32(height) + cells[1]) * np.int32(depth) + cells[2])


def build_surface_table(skipmap: SkipMap, neighbours: bool = True) -> SurfaceTable:
    """Index the effective voxels of a Skip-map by cell.

    Args:
        skipmap: the scan's Skip-map.
        neighbours: the cells next to a voxel lead to it too.
    """
    steps = _STEPS if neighbours else _STEPS[:1]
    size_m = skipmap.voxel_size_m
    cells = skipmap.cells
    low = (cells.min(axis=0) if len(cells) else np.zeros(3, dtype=np.int64)) - _MARGIN
    shape = tuple(int(n) for n in (cells - low).max(axis=0, initial=0) + _MARGIN + 1)
    corner_m = skipmap.origin_m + low * size_m
    row = np.arange(len(skipmap), dtype=np.int32)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    if np.prod(shape, dtype=float) > _LARGEST_BOX:
        index = CellIndex(pack(cells - low))
        for step in steps[1:]:
            index.insert(pack(cells - low + step), row)
        return SurfaceTable(size_m, corner_m, shape, index)
    rows = np.full(int(np.prod(shape)), -1, dtype=np.int32)
    number = (cells - low) @ strides
    for step in steps[::-1]:  # what is fewest steps away is written last
        rows[number + step @ strides] = row
    return SurfaceTable(size_m, corner_m, shape, rows)
