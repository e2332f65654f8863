"""Finding out whether a scan was taken from its origin, instead of assuming it."""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

MAX_HIDDEN_SHARE = 0.05
"""Of scans from one place at most this share of voxels seems hidden (noise, porous trees: 4 % of an
apartment); of fused and moving ones up to several times as much."""
MIN_FALLOFF = 0.25
"""Correlation of a scan's density with what its sensor's place predicts: about 0.5 before objects,
0.3 and more for raw scans of any kind, at most 0.22 about places inside an object; thinned and
fused scans have little of it left."""
_BEHIND_EXTENTS = 3.0
_FLAT_CURVATURE = 0.03
_MIN_COSINE = 0.2
_MIN_SLANT_COSINE = 0.1


def find_viewpoint(skipmap: SkipMap, origin_m: FloatArray) -> FloatArray | None:
    """The origin if the scan can have been taken from there, else None.

    An object scanned from outside hides nothing from a place inside it either, and the origin often
    lies there: so where a scan could as well have been taken from the other side of its surfaces,
    its density must speak for the origin.

    Args:
        skipmap: the scan's Skip-map; its own viewpoint does not matter.
        origin_m: (3,) origin of the frame in which the scan was given, in the Skip-map's frame.
    """
    if len(skipmap) == 0 or hidden_share(skipmap, origin_m) > MAX_HIDDEN_SHARE:
        return None
    if density_falloff(skipmap, origin_m) >= MIN_FALLOFF:
        return origin_m
    hidden_from_behind = hidden_share(skipmap, _behind(skipmap, origin_m))
    return origin_m if hidden_from_behind > MAX_HIDDEN_SHARE else None


def density_falloff(skipmap: SkipMap, viewpoint_m: FloatArray) -> float:
    """How well a scan's density agrees with a sensor at (3,) ``viewpoint_m``.

    Whatever its pattern, a sensor's points spread out with the square of the range, and along a
    slanted surface with the cosine of the angle.

    Returns:
        Correlation over the voxels between the logarithms of points and of cosine / range^2, -1 to
        1; 0 says nothing, as do fewer than three voxels.
    """
    to_sensor_m = viewpoint_m - skipmap.centroids_m
    range_m = np.linalg.norm(to_sensor_m, axis=1)
    away_m = np.abs(np.einsum("vi,vi->v", to_sensor_m, skipmap.normals))
    rows = np.flatnonzero(away_m > _MIN_SLANT_COSINE * range_m)
    if len(rows) < 3:
        return 0.0
    expected, counts = np.log(away_m[rows] / range_m[rows] ** 3), np.log(skipmap.counts[rows])
    if min(np.ptp(expected), np.ptp(counts)) == 0:
        return 0.0
    return float(np.corrcoef(expected, counts)[0, 1])


def _behind(skipmap: SkipMap, viewpoint_m: FloatArray) -> FloatArray:
    """(3,) a place far behind the surfaces, as seen from ``viewpoint_m``."""
    towards = skipmap.seen_from(viewpoint_m).normals.sum(axis=0)
    extent_m = np.linalg.norm(np.ptp(skipmap.centroids_m, axis=0))
    way = -towards / max(float(np.linalg.norm(towards)), 1e-12)
    return skipmap.centroids_m.mean(axis=0) + _BEHIND_EXTENTS * extent_m * way


def hidden_share(skipmap: SkipMap, viewpoint_m: FloatArray, samples: int = 1000) -> float:
    """Share of voxels that a sensor at (3,) ``viewpoint_m`` cannot have seen: 0 for the true one.

    A voxel is hidden when its line of sight pierces a flat voxel on the way. The lines are walked
    from the voxels towards the sensor, as far as the scan reaches.

    Args:
        skipmap: the scan's Skip-map.
        viewpoint_m: (3,) assumed sensor position, in the same frame.
        samples: voxels to look at, evenly spread.
    """
    count = min(len(skipmap), samples)
    if count == 0:
        return 0.0
    voxel_m = skipmap.voxel_size_m
    points_m = skipmap.centroids_m[np.linspace(0, len(skipmap) - 1, count).astype(np.int64)]
    to_sensor_m = viewpoint_m - points_m
    range_m = np.linalg.norm(to_sensor_m, axis=1)
    ways = to_sensor_m / np.maximum(range_m, 1e-9)[:, None]
    extent_m = float(np.linalg.norm(np.ptp(skipmap.centroids_m, axis=0)))
    ends_m = np.minimum(range_m - voxel_m, extent_m)
    line, row = skipmap.table.find_along(points_m, ways, 1.5 * voxel_m, ends_m, 0.5 * voxel_m)
    hidden = np.zeros(count, dtype=bool)
    hidden[line[_pierces(skipmap, row, points_m[line], ways[line], viewpoint_m)]] = True
    return float(hidden.mean())


def _pierces(
    skipmap: SkipMap,
    row: IntArray,
    points_m: FloatArray,
    ways: FloatArray,
    viewpoint_m: FloatArray,
) -> BoolArray:
    """Whether lines from points towards the sensor pass through the middle of flat voxels.

    Both ends must be well off the voxel's plane: points of one slanted surface do not hide each
    other.
    """
    centres_m, normals = skipmap.centroids_m[row], skipmap.normals[row]
    behind_m = np.einsum("li,li->l", points_m - centres_m, normals)
    before_m = np.einsum("li,li->l", viewpoint_m - centres_m, normals)
    cosine = np.einsum("li,li->l", ways, normals)
    flat = (skipmap.curvatures[row] < _FLAT_CURVATURE) & (np.abs(cosine) > _MIN_COSINE)
    walked_m = -behind_m / np.where(flat, cosine, 1.0)
    aside_m = np.linalg.norm(points_m + walked_m[:, None] * ways - centres_m, axis=1)
    voxel_m = skipmap.voxel_size_m
    apart = (behind_m * before_m < 0) & (np.abs(before_m) > voxel_m)
    return flat & apart & (np.abs(behind_m) > 1.5 * voxel_m) & (aside_m < 0.5 * voxel_m)
