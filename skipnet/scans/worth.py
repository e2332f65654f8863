"""What each voxel is worth as evidence: the many voxels of one plane say one thing once.

Any pose that lays one large plane on another makes thousands of voxels agree, and says no more than
one that lays a small one on a small one. What stands on the plane fixes the pose. So a plane counts
as ``PLANE_WORTH`` voxels at most, however large it is.
"""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.primitives import FLAT_CURVATURE, Planes
from skipnet.skipmap.eigen import symmetric_eigh
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

PLANE_WORTH = 50.0
"""Voxels that a plane counts as at most."""
SMOOTH_WORTH = 300.0
"""Voxels that all other smooth surfaces count as at most, tanks' and pipes' walls and skin ..."""
LEAST_SMOOTH = 0.15
"""... but each for this: some of them are all that there is."""
TOLERANCE_VOXELS = 0.25
"""Farthest from a plane that a voxel belongs to it: what bends, as skin or ground, is no plane."""
MIN_COSINE = 0.98
"""Likewise, between the normals."""
_LOOSE_VOXELS, _LOOSE_COSINE = 1.0, 0.97
_FITS = 2
_FEW = 20
"""Voxels that are not worth a fit of their own."""


def voxel_worth(skipmap: SkipMap, planes: Planes) -> FloatArray:
    """(V,) what each voxel counts for, above 0 and up to 1 for those of no large plane.

    Args:
        skipmap: the scan's Skip-map.
        planes: of it, heaviest first.
    """
    size = np.ones(len(skipmap))
    points_m, normals, voxel_m = skipmap.centroids_m, skipmap.normals, skipmap.voxel_size_m
    free, rows = np.ones(len(skipmap), dtype=bool), np.empty(len(skipmap), dtype=np.int32)
    for normal, offset_m in zip(planes.normals, planes.offsets_m, strict=True):
        count = _take_free(points_m, normals, normal, offset_m, _LOOSE_VOXELS * voxel_m, free, rows)
        members = _tight(points_m, normals, rows[:count], voxel_m)
        size[members] = max(len(members), 1)
    worth = np.minimum(1.0, PLANE_WORTH / size)
    smooth = (size < PLANE_WORTH) & (skipmap.curvatures < FLAT_CURVATURE)
    worth[smooth] *= np.clip(SMOOTH_WORTH / max(int(smooth.sum()), 1), LEAST_SMOOTH, 1.0)
    return worth


def _tight(points_m: FloatArray, normals: FloatArray, rows: IntArray, voxel_m: float) -> IntArray:
    """Those of (K,) rows of (V, 3) points that lie on one plane to a share of a voxel."""
    if len(rows) < _FEW:
        return rows
    members, kept = rows, np.empty_like(rows)
    for _ in range(_FITS):
        centre_m, squares_m2 = np.zeros(3), np.zeros(6)
        _add_up(points_m, members, centre_m, squares_m2)
        normal = symmetric_eigh(squares_m2[None])[1][0, :, 0]
        count = _take_near(
            points_m, normals, rows, centre_m, normal, TOLERANCE_VOXELS * voxel_m, kept
        )
        members = kept[:count]
        if count < _FEW:
            break
    return members


@compiled
def _take_free(
    points_m: FloatArray,
    normals: FloatArray,
    normal: FloatArray,
    offset_m: float,
    reach_m: float,
    free: BoolArray,
    rows: IntArray,
) -> int:
    """Rows of the free ones of (V, 3) points roughly on a plane, which are free no more; how many
    there are."""
    n_x, n_y, n_z, count = normal[0], normal[1], normal[2], 0
    for v in range(len(points_m)):
        away_m = n_x * points_m[v, 0] + n_y * points_m[v, 1] + n_z * points_m[v, 2] - offset_m
        cosine = n_x * normals[v, 0] + n_y * normals[v, 1] + n_z * normals[v, 2]
        if free[v] and abs(away_m) < reach_m and abs(cosine) > _LOOSE_COSINE:
            free[v] = False
            rows[count] = v
            count += 1
    return count


@compiled
def _take_near(
    points_m: FloatArray,
    normals: FloatArray,
    rows: IntArray,
    centre_m: FloatArray,
    normal: FloatArray,
    reach_m: float,
    kept: IntArray,
) -> int:
    """Those of (K,) rows that lie on a plane, into ``kept``; how many there are."""
    n_x, n_y, n_z, count = normal[0], normal[1], normal[2], 0
    for k in range(len(rows)):
        v = rows[k]
        away_m = n_x * (points_m[v, 0] - centre_m[0]) + n_y * (points_m[v, 1] - centre_m[1])
        away_m += n_z * (points_m[v, 2] - centre_m[2])
        cosine = n_x * normals[v, 0] + n_y * normals[v, 1] + n_z * normals[v, 2]
        kept[count] = v
        count += (abs(away_m) < reach_m) & (abs(cosine) > MIN_COSINE)
    return count


@compiled
def _add_up(
    points_m: FloatArray, rows: IntArray, centre_m: FloatArray, squares_m2: FloatArray
) -> None:
    """The centre of (K,) rows of (V, 3) points and xx, xy, xz, yy, yz, zz about it, into zeros."""
    for row in rows:
        for i in range(3):
            centre_m[i] += points_m[row, i] / len(rows)
    for row in rows:
        x, y = points_m[row, 0] - centre_m[0], points_m[row, 1] - centre_m[1]
        z = points_m[row, 2] - centre_m[2]
        for entry, product in enumerate((x * x, x * y, x * z, y * y, y * z, z * z)):
            squares_m2[entry] += product
