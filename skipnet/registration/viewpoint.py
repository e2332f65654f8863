"""Finding out whether a scan was taken from its origin, instead of assuming it."""

from __future__ import annotations

import numpy as np

from skipnet.registration.verification import octahedral_bin
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

MAX_HIDDEN_SHARE = 0.02
"""Of scans from one place at most this share of voxels seems hidden (noise, porous trees); of fused
and moving ones several times as much."""
_BINS = 160


def find_viewpoint(skipmap: SkipMap, origin_m: FloatArray) -> FloatArray | None:
    """The origin if the scan can have been taken from there, else None.

    Args:
        skipmap: the scan's Skip-map; its own viewpoint does not matter.
        origin_m: (3,) origin of the frame in which the scan was given, in the Skip-map's frame.
    """
    return origin_m if hidden_share(skipmap, origin_m) <= MAX_HIDDEN_SHARE else None


def hidden_share(skipmap: SkipMap, viewpoint_m: FloatArray) -> float:
    """Share of voxels that a sensor at (3,) ``viewpoint_m`` cannot have seen: 0 for the true one.

    A voxel counts as hidden when its line of sight passes through the nearest voxel in that
    direction, a flat one, from its front to its back. Points further out on one slanted surface do
    not hide each other.
    """
    if len(skipmap) == 0:
        return 0.0
    offset_m = skipmap.centroids_m - viewpoint_m
    range_m = np.linalg.norm(offset_m, axis=1)
    direction = offset_m / np.maximum(range_m, 1e-9)[:, None]
    nearest = _nearest_in_bin(octahedral_bin(offset_m.astype(np.float32), _BINS), range_m)
    to_nearest_m = offset_m[nearest]
    normals = skipmap.normals[nearest]
    aside_m = np.linalg.norm(np.cross(to_nearest_m, direction), axis=1)
    behind_m = np.einsum("vi,vi->v", offset_m - to_nearest_m, normals)
    sensor_m = -np.einsum("vi,vi->v", to_nearest_m, normals)
    voxel_m = skipmap.voxel_size_m
    hidden = (behind_m * sensor_m < 0) & (np.abs(behind_m) > 1.5 * voxel_m)
    hidden &= (np.abs(sensor_m) > voxel_m) & (aside_m < 0.5 * voxel_m)
    hidden &= np.abs(np.einsum("vi,vi->v", direction, normals)) > 0.2
    hidden &= skipmap.curvatures[nearest] < 0.03
    return float(hidden.mean())


def _nearest_in_bin(bins: IntArray, range_m: FloatArray) -> IntArray:
    """For each voxel the row of the nearest voxel in its direction's bin."""
    order = np.lexsort((range_m, bins))
    first = np.r_[True, np.diff(bins[order]) != 0]
    nearest = np.empty(len(bins), dtype=np.int64)
    nearest[order] = np.repeat(order[first], np.diff(np.append(np.flatnonzero(first), len(bins))))
    return nearest
