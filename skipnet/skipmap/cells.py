"""Integer cells of a voxel grid: three indices in one sortable key."""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.grouping import (
    BITS,
    CELL_MAX,
    CELL_MIN,
    CELL_OFFSET,
    NO_ROWS,
    group_points,
    sort_groups,
)
from skipnet.types import FloatArray, IntArray

_MASK = (1 << BITS) - 1
_FIELDS = (1 << (2 * BITS)) + (1 << BITS) + 1
"""A one in each of a key's three fields."""
_LOW_BITS = _FIELDS * (_MASK >> 1)
_HALF_OFFSETS = _FIELDS * (CELL_OFFSET >> 1)


def cells_of(points_m: FloatArray, voxel_size_m: float, origin_m: FloatArray) -> IntArray:
    """The (..., 3) int32 cell that holds each point: floor((p - origin) / voxel size).

    Raises:
        ValueError: a point lies more than 2^20 voxels from the origin.
    """
    scaled = points_m - origin_m
    scaled *= 1.0 / voxel_size_m
    np.floor(scaled, out=scaled)
    if scaled.size and not (scaled.min() >= CELL_MIN and scaled.max() <= CELL_MAX):
        raise _too_far(voxel_size_m)
    return scaled.astype(np.int32)


def _too_far(voxel_size_m: float) -> ValueError:
    return ValueError(
        f"points reach more than {CELL_OFFSET} voxels of {voxel_size_m:g} m from the origin; "
        "remove far outliers or choose a larger voxel_size_m"
    )


def pack(cells: IntArray) -> IntArray:
    """One non-negative int64 key per (..., 3) cell; keys sort by x, then y, then z."""
    x, y, z = (cells[..., axis].astype(np.int64) + CELL_OFFSET for axis in range(3))
    return (x << (2 * BITS)) | (y << BITS) | z


def unpack(keys: IntArray) -> IntArray:
    """The (..., 3) int64 cells of packed keys; the inverse of ``pack``.

    Axis by axis in memory: whatever is done to all cells is several times faster that way.

    >>> unpack(pack(np.array([[1, -2, 3]])))
    array([[ 1, -2,  3]])
    """
    axes = (keys >> (2 * BITS), (keys >> BITS) & _MASK, keys & _MASK)
    return np.moveaxis(np.stack(axes) - CELL_OFFSET, 0, -1)


def halve(keys: IntArray) -> IntArray:
    """Keys of the cells twice as wide that hold (V,) cells: ``pack(unpack(keys) >> 1)``, quickly.

    >>> unpack(halve(pack(np.array([[5, -1, -4]]))))
    array([[ 2, -1, -2]])
    """
    return halve_steps(keys) + _HALF_OFFSETS


def halve_steps(keys: IntArray) -> IntArray:
    """Likewise of (V,) steps up from a lowest cell: keys from which that cell's was subtracted.

    Halved often enough, all become 0; as keys, those on both sides of the origin never meet.

    >>> halve_steps(pack(np.array([5, 7, -4])) - pack(np.array([0, 0, -8]))) == (
    ...     pack(np.array([2, 3, 2])) - pack(np.zeros(3, int))
    ... )
    np.True_
    """
    return (keys >> 1) & _LOW_BITS


def group_by_cell(
    points_m: FloatArray, voxel_size_m: float, T_grid_points: FloatArray
) -> tuple[IntArray, IntArray]:
    """Which points share a cell of a grid with a corner at the origin.

    Args:
        points_m: (N, 3) points.
        voxel_size_m: edge of a cell.
        T_grid_points: (4, 4) motion of the points into the grid's frame.

    Returns:
        (G,) packed keys of the occupied cells, ascending, and the (N,) int32 row among them that
        holds each point.

    Raises:
        ValueError: as ``cells_of``.
    """
    row = np.empty(len(points_m), dtype=np.int32)
    keys = _group_points(points_m, voxel_size_m, T_grid_points, row)
    return sort_groups(keys, row), row


def occupied_cells(
    points_m: FloatArray, voxel_size_m: float, T_grid_points: FloatArray
) -> IntArray:
    """The (G,) packed keys of the cells that hold points, in no order; see ``group_by_cell``."""
    return _group_points(points_m, voxel_size_m, T_grid_points, NO_ROWS)


def _group_points(
    points_m: FloatArray, voxel_size_m: float, T_grid_points: FloatArray, row: IntArray
) -> IntArray:
    keys = group_points(points_m, T_grid_points * (1.0 / voxel_size_m), row)
    if len(keys) == 0 < len(points_m):
        raise _too_far(voxel_size_m)
    return keys
