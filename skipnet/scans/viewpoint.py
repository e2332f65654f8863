"""How well a place explains what a scan shows: nobody need assume where it was taken from.

What is seen from one place hides nothing of it and thins out with the range. A camera that moved
while its views were fused hides a little; the origin of a map that was never a sensor's place hides
a lot, lies on walls and floors, and knows nothing of the density.
"""

from __future__ import annotations

import numpy as np

from skipnet.clouds.statistics import bounds
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

HIDDEN_SHARE = (0.10, 0.25)
"""A place that hides no more than the first of a scan explains it, one that hides the second
explains nothing. Of simulated fragments that were fused from a moving camera 95 of 100 hide at most
8 %, of single scans 1 %; maps hide 10 to 70 % from their corners, floors and middles."""
FALLOFF = (0.15, 0.30)
"""Correlation of a scan's density with what its sensor's place predicts: 0.3 and more for raw scans
of any kind, at most 0.23 about places inside an object; between the two it speaks for a place as
far as it has come."""
MARGIN_PER_FALLOFF = 0.2
"""Where the density speaks for a place, porous trees may hide more, by this per correlation above
the second of ``FALLOFF``."""
FAINT_FALLOFF = (-0.05, 0.08)
"""What is left of the correlation in thinned and fused clouds, which are even. Then a place must be
no worse than one behind the surfaces, from where ..."""
HIDDEN_FROM_BEHIND = (0.01, 0.05)
"""... this share must be hidden, and ..."""
LESS_THAN_BEHIND = (-0.06, -0.02)
"""... more than from the place itself, but for this."""
_BEHIND_EXTENTS = 3.0
_FLAT_CURVATURE = 0.03
_MIN_COSINE = 0.2
MIN_SLANT_COSINE = 0.1
_CORE_VOXELS = 0.2
"""A line that passes the centroid of a curved voxel by less than this hits what is in it."""
SIDE_COSINE = (0.05, 0.15)
"""A surface seen at a smaller cosine than the first may be seen from its other side, as its normal
errs; at the second its side is known."""
SIDE_VOXELS = (0.5, 1.5)
"""Likewise for the distance of the sensor from the surface's plane."""


def trust_in(
    skipmap: SkipMap, fine: SkipMap, viewpoint_m: FloatArray, is_given: bool = False
) -> float:
    """How far a scan can have been taken from a place: what its evidence is worth.

    An object scanned from outside hides nothing from a place inside it either, and the origin often
    lies there: so where the density is silent, the surfaces must look worse from behind.

    Args:
        skipmap: the scan's Skip-map; its own viewpoint does not matter.
        fine: the same scan's at the finest level: there thin things are seen to hide others, on
            the level above those of which the scan has few points.
        viewpoint_m: (3,) the place, in the Skip-maps' frame.
        is_given: somebody knows that a sensor was there or nearby; only what it hides counts.

    Returns:
        0: this place tells nothing about sides and free space; 1: what it tells holds.
    """
    if min(len(skipmap), len(fine)) == 0:
        return 0.0
    maps = skipmap, fine
    falloff = density_falloff(skipmap, viewpoint_m)
    margin = MARGIN_PER_FALLOFF * max(falloff - FALLOFF[1], 0.0)
    hidden = most_hidden(maps, viewpoint_m, HIDDEN_SHARE[1] + margin)
    explained = 1 - ramp(hidden - margin, HIDDEN_SHARE)
    dense = 1.0 if is_given else ramp(falloff, FALLOFF)
    if explained == 0 or dense == 1:
        return float(explained)
    behind_m = _behind(skipmap, viewpoint_m)
    enough = max(HIDDEN_FROM_BEHIND[1], hidden + LESS_THAN_BEHIND[1])
    from_behind = most_hidden(maps, behind_m, enough)
    in_front = ramp(from_behind, HIDDEN_FROM_BEHIND)
    in_front *= ramp(from_behind - hidden, LESS_THAN_BEHIND)
    return float(explained * max(dense, ramp(falloff, FAINT_FALLOFF) * in_front))


def most_hidden(maps: tuple[SkipMap, ...], viewpoint_m: FloatArray, enough: float) -> float:
    """The largest of the maps' hidden shares, or the first one that is enough."""
    most = 0.0
    for one in maps:
        most = max(most, hidden_share(one, viewpoint_m))
        if most >= enough:
            break
    return most


def sides(skipmap: SkipMap, viewpoint_m: FloatArray) -> FloatArray:
    """How surely a sensor at (3,) ``viewpoint_m`` tells the side of each voxel's surface.

    Returns:
        (V,) float32: 0 for surfaces seen edge-on, whose normals may err to the other side, to 1.
    """
    to_sensor_m = viewpoint_m - skipmap.centroids_m
    away_m = np.abs(np.einsum("vi,vi->v", to_sensor_m, skipmap.normals))
    cosine = away_m / np.maximum(np.linalg.norm(to_sensor_m, axis=1), 1e-9)
    sure = np.minimum(ramp(cosine, SIDE_COSINE), ramp(away_m / skipmap.voxel_size_m, SIDE_VOXELS))
    return sure.astype(np.float32)


def ramp(value: FloatArray | float, ends: tuple[float, float]) -> FloatArray | float:
    """0 up to the first end, 1 from the second on, straight between."""
    return np.clip((value - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)


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
    rows = np.flatnonzero(away_m > MIN_SLANT_COSINE * range_m)
    if len(rows) < 3:
        return 0.0
    expected, counts = np.log(away_m[rows] / range_m[rows] ** 3), np.log(skipmap.counts[rows])
    if min(np.ptp(expected), np.ptp(counts)) == 0:
        return 0.0
    return float(np.corrcoef(expected, counts)[0, 1])


def _behind(skipmap: SkipMap, viewpoint_m: FloatArray) -> FloatArray:
    """(3,) a place far behind the surfaces, as seen from ``viewpoint_m``."""
    towards = skipmap.seen_from(viewpoint_m).normals.sum(axis=0)
    extent_m = diagonal_m(skipmap.centroids_m)
    way = -towards / max(float(np.linalg.norm(towards)), 1e-12)
    return skipmap.centroids_m.mean(axis=0) + _BEHIND_EXTENTS * extent_m * way


def diagonal_m(points_m: FloatArray) -> float:
    """Of the box about (N, 3) points."""
    low_m, high_m = bounds(points_m)
    return float(np.linalg.norm(high_m - low_m))


def hidden_share(skipmap: SkipMap, viewpoint_m: FloatArray, samples: int = 300) -> float:
    """Share of voxels that a sensor at (3,) ``viewpoint_m`` cannot have seen: 0 for the true one.

    A voxel is hidden when its line of sight passes right through another one on the way. The lines
    are walked from the voxels towards the sensor, as far as the scan reaches.

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
    extent_m = diagonal_m(skipmap.centroids_m)
    ends_m = np.minimum(range_m - voxel_m, extent_m)
    line, row = skipmap.table.find_along(points_m, ways, 1.5 * voxel_m, ends_m, 0.5 * voxel_m)
    blocks = _pierces(skipmap, row, points_m[line], ways[line], viewpoint_m)
    blocks |= _hits_core(skipmap, row, points_m[line], ways[line], range_m[line])
    hidden = np.zeros(count, dtype=bool)
    hidden[line[blocks]] = True
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


def _hits_core(
    skipmap: SkipMap, row: IntArray, points_m: FloatArray, ways: FloatArray, range_m: FloatArray
) -> BoolArray:
    """Whether lines from points towards the sensor pass through the core of curved voxels.

    Thin plates and columns are curved at the size of a voxel, and hide things all the same.
    """
    to_centre_m = skipmap.centroids_m[row] - points_m
    along_m = np.einsum("li,li->l", to_centre_m, ways)
    aside_m = np.linalg.norm(to_centre_m - along_m[:, None] * ways, axis=1)
    voxel_m = skipmap.voxel_size_m
    between = (along_m > 2.5 * voxel_m) & (along_m < range_m - voxel_m)
    curved = skipmap.curvatures[row] >= _FLAT_CURVATURE
    return curved & between & (aside_m < _CORE_VOXELS * voxel_m)
