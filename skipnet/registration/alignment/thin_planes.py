"""Sparse scans laid on each other's planes, across the direction that little else holds.

A scanner with few lines sees a floor or a ceiling as two or three arcs, metres apart. They have no
neighbours in the other scan, so GICP cannot tell how far one floor lies above the other; yet an
arc alone tells its plane to a fraction of the noise. A plane found in one scan is looked for among
the points of the other: many at exactly one distance from it are the same plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import transform_points
from skipnet.registration.alignment.refinement import Refinement
from skipnet.skipmap.eigen import symmetric_eigh
from skipnet.types import FloatArray

SHRINKING_VOXELS = (1.0, 0.5, 0.25, 0.12, 0.08, 0.08)
"""Distances from the plane within which its points are taken, fit after fit."""
MIN_POINTS = 25
"""Of a plane. Scan lines on walls are not this thin."""
MAX_SCATTER = 0.25
"""Of a plane's points, as a share of the last distance: lines that cross the slab scatter 0.5."""
MIN_EXTENT_VOXELS = 3.0
"""Spread of a plane's points along its shorter side: less is one straight scan line."""
MIN_SENSOR_VOXELS = 2.5
"""Distance of the sensor from a plane: its level scan lines lie in a plane too, on all walls."""
MAX_TILT_COSINE = 0.97
"""Between a plane's normal and the direction asked about."""
PEAKS = 30
"""Heights to try in each scan."""
MODE_VOXELS = 0.03
"""Half width of the heap of points that lie on the other scan's plane ..."""
WIDE_VOXELS = 0.1
"""... of those around it, of which most must be in the heap ..."""
MIN_HEAP = 15
"""... that must hold so many points ..."""
MIN_SHARE = 0.7
MIN_DENSITY = 4.0
"""... and be so much denser than the points are on average, up to a voxel from the plane."""
HEAP_HOLD = 10.0
"""Independent points that a heap counts as: a plane fitted to arcs and carried on to where the
other scan's lie errs as a whole. On 20 calibration pairs of 16 lines the height was off by up to 15
times what the heap's own number would leave."""


@dataclass(frozen=True)
class ThinPlane:
    """A plane with its points' scatter."""

    normal: FloatArray
    offset_m: float
    """normal . p of its points."""
    scatter_m: float


def lay_on_planes(
    fine: Refinement,
    source_m: FloatArray,
    target_m: FloatArray,
    source_viewpoint_m: FloatArray | None,
    target_viewpoint_m: FloatArray | None,
    voxel_size_m: float,
) -> Refinement:
    """Correct one pose along the direction that is held least.

    Args:
        fine: a single pose, right to less than a voxel along that direction.
        source_m: (N, 3) points, source frame.
        target_m: (M, 3) points, target frame.
        source_viewpoint_m: (3,) sensor, source frame; without it nothing is changed.
        target_viewpoint_m: likewise, target frame.
        voxel_size_m: edge of a voxel.
    """
    if source_viewpoint_m is None or target_viewpoint_m is None or fine.matched[0] == 0:
        return fine
    T = fine.T_target_source[0].copy()
    source_m = transform_points(T, source_m)
    source_viewpoint_m = transform_points(T, source_viewpoint_m[None])[0]
    weak = np.linalg.eigh(fine.covariance[0][3:, 3:])[1][:, -1]
    found = [
        (plane, sign * heap[0], heap[1])
        for sign, own_m, other_m, viewpoint_m in (
            (1, target_m, source_m, target_viewpoint_m),
            (-1, source_m, target_m, source_viewpoint_m),
        )
        for plane in find_thin_planes(own_m, weak, viewpoint_m, voxel_size_m)
        if (heap := heap_beside(other_m, plane, voxel_size_m)) is not None
    ]
    if not found:
        return fine
    planes, above_m, points = zip(*found, strict=True)
    if np.ptp(above_m) > WIDE_VOXELS * voxel_size_m:
        return fine  # they contradict each other: at least one is no common plane
    shift_m = -np.average(above_m, weights=points)
    T[:3, 3] += shift_m * planes[0].normal
    information = fine.information[0].copy()
    for plane, heap in zip(planes, points, strict=True):
        held = min(heap, HEAP_HOLD) / plane.scatter_m**2
        information[3:, 3:] += held * np.outer(plane.normal, plane.normal)
    return replace(fine, T_target_source=T[None], information=information[None])


def find_thin_planes(
    points_m: FloatArray, direction: FloatArray, viewpoint_m: FloatArray, voxel_size_m: float
) -> Iterator[ThinPlane]:
    """Planes roughly across a direction, at heights where many points are.

    Args:
        points_m: (N, 3) points of one scan.
        direction: (3,) unit vector.
        viewpoint_m: (3,) its sensor.
        voxel_size_m: edge of a voxel.
    """
    height_m = points_m @ direction
    step_m = voxel_size_m / 2
    low_m = height_m.min()
    counts = np.bincount(((height_m - low_m) / step_m).astype(np.int64))
    counts[:-1] += counts[1:].copy()
    left = np.ones(len(points_m), dtype=bool)
    for peak in np.argsort(-counts, kind="stable")[:PEAKS]:
        near = np.abs(height_m - (low_m + (peak + 1) * step_m)) < 1.5 * voxel_size_m
        plane = _fit(points_m[near & left], direction, voxel_size_m)
        if plane is None or abs(plane.normal @ viewpoint_m - plane.offset_m) < (
            MIN_SENSOR_VOXELS * voxel_size_m
        ):
            continue
        distance_m = np.abs(points_m @ plane.normal - plane.offset_m)
        left &= distance_m > 2 * SHRINKING_VOXELS[-1] * voxel_size_m
        yield plane


def heap_beside(
    points_m: FloatArray, plane: ThinPlane, voxel_size_m: float
) -> tuple[float, int] | None:
    """How far above a plane many points of another scan lie, all at one height; None if none do.

    Returns:
        The height of the heap and its number of points.
    """
    above_m = points_m @ plane.normal - plane.offset_m
    above_m = above_m[np.abs(above_m) < voxel_size_m]
    if len(above_m) < MIN_HEAP:
        return None
    width_m = 2 * MODE_VOXELS * voxel_size_m
    height_m, heap = _densest(above_m, width_m)
    wide = int((np.abs(above_m - height_m) < WIDE_VOXELS * voxel_size_m).sum())
    usual = len(above_m) * width_m / (2 * voxel_size_m)
    if heap < max(MIN_HEAP, MIN_SHARE * wide, MIN_DENSITY * usual):
        return None
    return height_m, heap


def _fit(points_m: FloatArray, direction: FloatArray, voxel_size_m: float) -> ThinPlane | None:
    """The plane through (N, 3) points, fitted to ever closer ones of them; None if not thin."""
    for distance_voxels in SHRINKING_VOXELS:
        plane = _plane_through(points_m, direction, voxel_size_m)
        if plane is None:
            return None
        away_m = points_m @ plane.normal - plane.offset_m
        reach_m = distance_voxels * voxel_size_m
        points_m = points_m[np.abs(away_m - _densest(away_m, reach_m)[0]) < reach_m]
    plane = _plane_through(points_m, direction, voxel_size_m)
    limit_m = MAX_SCATTER * SHRINKING_VOXELS[-1] * voxel_size_m
    return plane if plane is not None and plane.scatter_m < limit_m else None


def _densest(heights_m: FloatArray, width_m: float) -> tuple[float, int]:
    """Where most of (N,) heights lie within a width: their median, and their number."""
    heights_m = np.sort(heights_m)
    first, count = _most_within(heights_m, width_m)
    low_m, high_m = heights_m[first + (count - 1) // 2], heights_m[first + count // 2]
    return float((low_m + high_m) / 2), count


@compiled
def _most_within(heights_m: FloatArray, width_m: float) -> tuple[int, int]:
    """Of (N,) ascending heights the first of the most that lie within a width, and their number."""
    first, most, end = 0, 0, 0
    for k in range(len(heights_m)):
        while end < len(heights_m) and heights_m[end] <= heights_m[k] + width_m:
            end += 1
        if end - k > most:
            first, most = k, end - k
    return first, most


def _plane_through(
    points_m: FloatArray, direction: FloatArray, voxel_size_m: float
) -> ThinPlane | None:
    """Least-squares plane; None through few points, along one line, or tilted too far."""
    if len(points_m) < MIN_POINTS:
        return None
    centre_m, covariance_m2 = np.zeros(3), np.zeros(6)
    _add_up(points_m, centre_m, covariance_m2)
    values_m2, vectors = (one[0] for one in symmetric_eigh(covariance_m2[None]))
    normal = vectors[:, 0] * math.copysign(1.0, vectors[:, 0] @ direction)
    straight = values_m2[1] < (MIN_EXTENT_VOXELS * voxel_size_m) ** 2
    if straight or normal @ direction < MAX_TILT_COSINE:
        return None
    return ThinPlane(normal, float(normal @ centre_m), math.sqrt(max(values_m2[0], 1e-12)))


@compiled
def _add_up(points_m: FloatArray, centre_m: FloatArray, covariance_m2: FloatArray) -> None:
    """The centre of (N, 3) points and xx, xy, xz, yy, yz, zz of their covariance, into zeros."""
    for k in range(len(points_m)):
        for i in range(3):
            centre_m[i] += points_m[k, i] / len(points_m)
    for k in range(len(points_m)):
        x, y = points_m[k, 0] - centre_m[0], points_m[k, 1] - centre_m[1]
        z = points_m[k, 2] - centre_m[2]
        for entry, product in enumerate((x * x, x * y, x * z, y * y, y * z, z * z)):
            covariance_m2[entry] += product / len(points_m)
