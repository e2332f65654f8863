"""What each voxel is worth as evidence: the many voxels of one plane say one thing once.

Any pose that lays one large plane on another makes thousands of voxels agree, and says no more than
one that lays a small one on a small one. What stands on the plane fixes the pose. So a plane counts
as ``PLANE_WORTH`` voxels at most, however large it is.
"""

from __future__ import annotations

import numpy as np

from skipnet.features.primitives import FLAT_CURVATURE, Planes
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

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
    points_m, normals = skipmap.centroids_m, skipmap.normals
    free = np.ones(len(skipmap), dtype=bool)
    for normal, offset_m in zip(planes.normals, planes.offsets_m, strict=True):
        apart_m = np.abs(points_m @ normal - offset_m)
        near = free & (apart_m < _LOOSE_VOXELS * skipmap.voxel_size_m)
        rows = np.flatnonzero(near & (np.abs(normals @ normal) > _LOOSE_COSINE))
        free[rows] = False
        members = _tight(points_m[rows], normals[rows], normal, skipmap.voxel_size_m)
        size[rows[members]] = max(len(members), 1)
    worth = np.minimum(1.0, PLANE_WORTH / size)
    smooth = (size < PLANE_WORTH) & (skipmap.curvatures < FLAT_CURVATURE)
    worth[smooth] *= np.clip(SMOOTH_WORTH / max(int(smooth.sum()), 1), LEAST_SMOOTH, 1.0)
    return worth


def _tight(
    points_m: FloatArray, normals: FloatArray, normal: FloatArray, voxel_m: float
) -> IntArray:
    """Those of (N, 3) points that lie on one plane to a share of a voxel, by number."""
    members: IntArray = np.arange(len(points_m))
    if len(points_m) < _FEW:
        return members
    for _ in range(_FITS):
        centre_m = points_m[members].mean(axis=0)
        offsets_m = points_m[members] - centre_m
        normal = np.linalg.eigh(offsets_m.T @ offsets_m)[1][:, 0]
        apart_m = np.abs((points_m - centre_m) @ normal)
        on_it = (apart_m < TOLERANCE_VOXELS * voxel_m) & (np.abs(normals @ normal) > MIN_COSINE)
        members = np.flatnonzero(on_it)
        if len(members) < _FEW:
            break
    return members
