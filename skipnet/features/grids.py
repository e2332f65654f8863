"""Cylindrical grids: what lies around a voxel, finely divided, at two scales.

A cylinder about the axis of the surface around a voxel is cut into 8 heights x 6 radii x 16
sectors. Each cell holds the logarithm of 1 + the voxel centroids in it, and the mean products of
their surfaces' normals in the cylinder's own axes (along, outwards, around): products need no sign.
The first tangent of the frame is arbitrary: turning it about the axis shifts the sectors.
"""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.frames import level_of, runs_around, tangent_frames
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

_Vector = tuple[float, float, float]

SCALES, HEIGHTS, RADII, SECTORS = 2, 8, 6, 16
CHANNELS = 7
"""The logarithm of the count; products along-along, outwards-outwards, around-around,
along-outwards, along-around, outwards-around."""
GRID_SHAPE = (SCALES, HEIGHTS, RADII, SECTORS, CHANNELS)
REACH_VOXELS = (7.0, 9.0)
"""Radius and half-height of each scale's cylinder in voxels of its level: the Skip-map's own, and
twice as wide."""
_TURNED_SIGNS = np.array([1, 1, 1, 1, -1, 1, -1], dtype=np.float32)
"""What the opposite axis makes of the channels: along and around change their signs, outwards does
not."""


def cylinder_grids(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """Describe (K,) voxels by the surfaces around them: (K, 2, 8, 6, 16, 7) float32."""
    grids = np.zeros((len(rows), *GRID_SHAPE), dtype=np.float32)
    if len(rows) == 0:
        return grids
    level = level_of(skipmap)
    frames = tangent_frames(skipmap, rows, level.coarser())
    for scale, reach in enumerate(REACH_VOXELS):
        if scale:
            level = level.coarser()
        middle = level.places(skipmap.centroids_m[rows])
        order, first, last = runs_around(middle, level.moments.mean, reach * 2**0.5)
        products = level.normals[:, 4:] / level.normals[:, :1]
        around = np.concatenate([level.moments.mean, products], axis=1)[order]
        _fill(
            grids[:, scale],
            middle.astype(np.float32),
            frames.astype(np.float32),
            np.ascontiguousarray(around, dtype=np.float32),
            first,
            last,
            reach,
        )
    return grids


def turned_over(grids: FloatArray) -> FloatArray:
    """The (K, 2, 8, 6, 16, 7) grids that the opposite axes would give: upside down, mirrored."""
    return grids[:, :, ::-1, :, ::-1] * _TURNED_SIGNS.astype(grids.dtype)


@compiled
def _finish(grid: FloatArray) -> None:
    """Turn sums into means and counts into logarithms, in one (8, 6, 16, 7) grid."""
    for i in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            for s in range(grid.shape[2]):
                cell = grid[i, j, s]
                if cell[0] > 0:
                    for channel in range(1, 7):
                        cell[channel] /= cell[0]
                    cell[0] = np.log(1 + cell[0])


@compiled
def _add(cell: FloatArray, there: FloatArray, axis: _Vector, out: _Vector) -> None:
    """Count one place in its (7,) cell, and add the products of its normals along three axes.

    Args:
        cell: to add to.
        there: (9,) row of ``around`` in ``_fill``.
        axis: of the cylinder.
        out: away from it, at this place.
    """
    a_x, a_y, a_z = axis
    o_x, o_y, o_z = out
    t_x, t_y, t_z = a_y * o_z - a_z * o_y, a_z * o_x - a_x * o_z, a_x * o_y - a_y * o_x
    xx, xy, xz, yy, yz, zz = there[3], there[4], there[5], there[6], there[7], there[8]
    na_x = xx * a_x + xy * a_y + xz * a_z
    na_y = xy * a_x + yy * a_y + yz * a_z
    na_z = xz * a_x + yz * a_y + zz * a_z
    no_x = xx * o_x + xy * o_y + xz * o_z
    no_y = xy * o_x + yy * o_y + yz * o_z
    no_z = xz * o_x + yz * o_y + zz * o_z
    along = na_x * a_x + na_y * a_y + na_z * a_z
    outwards = no_x * o_x + no_y * o_y + no_z * o_z
    cell[0] += 1
    cell[1] += along
    cell[2] += outwards
    cell[3] += xx + yy + zz - along - outwards
    cell[4] += na_x * o_x + na_y * o_y + na_z * o_z
    cell[5] += na_x * t_x + na_y * t_y + na_z * t_z
    cell[6] += no_x * t_x + no_y * t_y + no_z * t_z


@compiled
def _fill(
    grids: FloatArray,
    middle: FloatArray,
    frames: FloatArray,
    around: FloatArray,
    first: IntArray,
    last: IntArray,
    reach: float,
) -> None:
    """Count and average what lies around (K, 3) places.

    Args:
        grids: (K, 8, 6, 16, 7) zeros to fill.
        middle: the places.
        frames: (K, 3, 3) their axes and two tangents, in columns.
        around: (W, 9) places and the products xx, xy, xz, yy, yz, zz of normals, in the order of
            ``runs_around``.
        first: (K, 3) of ``runs_around``.
        last: likewise.
        reach: of the cylinder.
    """
    heights, radii, sectors = grids.shape[1], grids.shape[2], grids.shape[3]
    for k in range(len(middle)):
        a_x, a_y, a_z = frames[k, 0, 0], frames[k, 1, 0], frames[k, 2, 0]
        for run in range(3):
            for w in range(first[k, run], last[k, run]):
                x, y = around[w, 0] - middle[k, 0], around[w, 1] - middle[k, 1]
                z = around[w, 2] - middle[k, 2]
                height = x * a_x + y * a_y + z * a_z
                u = x * frames[k, 0, 1] + y * frames[k, 1, 1] + z * frames[k, 2, 1]
                v = x * frames[k, 0, 2] + y * frames[k, 1, 2] + z * frames[k, 2, 2]
                radius = np.sqrt(u * u + v * v)
                if abs(height) >= reach or radius >= reach or radius < 1e-3:
                    continue  # outside, or the voxel itself
                i = min(int((height + reach) / (2 * reach) * heights), heights - 1)
                j = min(int(radius / reach * radii), radii - 1)
                s = int(np.arctan2(v, u) / (2 * np.pi) * sectors + sectors) % sectors
                # Outwards and around, at this place of the cylinder.
                cosine, sine = u / radius, v / radius
                o_x = cosine * frames[k, 0, 1] + sine * frames[k, 0, 2]
                o_y = cosine * frames[k, 1, 1] + sine * frames[k, 1, 2]
                o_z = cosine * frames[k, 2, 1] + sine * frames[k, 2, 2]
                _add(grids[k, i, j, s], around[w], (a_x, a_y, a_z), (o_x, o_y, o_z))
        _finish(grids[k])
