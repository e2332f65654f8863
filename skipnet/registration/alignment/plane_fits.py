"""Thin planes through points about many heights at once, fitted to ever closer ones of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.eigen import symmetric_eigh
from skipnet.types import BoolArray, FloatArray, IntArray

SHRINKING_VOXELS = (1.0, 0.5, 0.25, 0.12, 0.08, 0.08)
"""Distances from the plane within which its points are taken, fit after fit."""
MIN_POINTS = 25
"""Of a plane. Scan lines on walls are not this thin."""
MAX_SCATTER = 0.25
"""Of a plane's points, as a share of the last distance: lines that cross the slab scatter 0.5."""
MIN_EXTENT_VOXELS = 3.0
"""Spread of a plane's points along its shorter side: less is one straight scan line."""
MAX_TILT_COSINE = 0.97
"""Between a plane's normal and the direction asked about."""


@dataclass(frozen=True)
class ThinPlane:
    """A plane with its points' scatter."""

    normal: FloatArray
    offset_m: float
    """normal . p of its points."""
    scatter_m: float


@dataclass(frozen=True)
class Fits:
    """Planes fitted about P heights, some of them thin."""

    normals: FloatArray
    """(P, 3)."""
    offsets_m: FloatArray
    """(P,)."""
    scatter_m: FloatArray
    """(P,)."""
    is_thin: BoolArray
    """(P,) the others may be anything."""

    def plane(self, k: int) -> ThinPlane:
        """One of them."""
        return ThinPlane(self.normals[k], float(self.offsets_m[k]), float(self.scatter_m[k]))


@dataclass(frozen=True)
class Members:
    """Points about P heights."""

    rows: IntArray
    """(P, M) int32 which points, as many as ..."""
    counts: IntArray
    """(P,) ... there are."""


def near_heights(
    height_m: FloatArray, left: BoolArray, heights_m: FloatArray, voxel_size_m: float
) -> Members:
    """Those of points at (N,) ascending heights that are left, within one and a half voxels of (P,)
    heights."""
    first = np.searchsorted(height_m, heights_m - 1.5 * voxel_size_m, side="right")
    last = np.searchsorted(height_m, heights_m + 1.5 * voxel_size_m)
    rows = [i + np.flatnonzero(left[i:j]) for i, j in zip(first, last, strict=True)]
    counts = np.array([len(one) for one in rows])
    members = np.zeros((len(rows), max(counts)), dtype=np.int32)
    for own, one in zip(members, rows, strict=True):
        own[: len(one)] = one
    return Members(members, counts)


def fit_planes(
    points_m: FloatArray, members: Members, direction: FloatArray, voxel_size_m: float
) -> Fits:
    """The planes through (N, 3) points about P heights, fitted to ever closer ones of them."""
    away_m, sorted_m = np.empty((2, *members.rows.shape), np.float32)  # sorted twice as fast
    for distance_voxels in SHRINKING_VOXELS:
        planes = _planes_through(points_m, members, direction, voxel_size_m)
        members.counts[~planes.is_thin] = 0
        _measure(points_m, members.rows, members.counts, planes.normals, planes.offsets_m, away_m)
        reach_m = distance_voxels * voxel_size_m
        for own_m, in_order_m, count in zip(away_m, sorted_m, members.counts, strict=True):
            in_order_m[:count] = np.sort(own_m[:count])
        _close_in(members.rows, members.counts, away_m, sorted_m, reach_m)
    planes = _planes_through(points_m, members, direction, voxel_size_m)
    limit_m = MAX_SCATTER * SHRINKING_VOXELS[-1] * voxel_size_m
    return replace(planes, is_thin=planes.is_thin & (planes.scatter_m < limit_m))


@compiled
def densest(heights_m: FloatArray, width_m: float) -> tuple[float, int]:
    """Where most of (N,) ascending heights lie within a width: their median, and their number."""
    first, count = _most_within(heights_m, width_m)
    return (heights_m[first + (count - 1) // 2] + heights_m[first + count // 2]) / 2, count


@compiled
def _most_within(heights_m: FloatArray, width_m: float) -> tuple[int, int]:
    """Of (N,) ascending heights the first of the most that lie within a width, and their number."""
    first, most = 0, 0
    for k in range(len(heights_m)):  # what holds no more than the most so far is passed over
        while k + most < len(heights_m) and heights_m[k + most] <= heights_m[k] + width_m:
            first, most = k, most + 1
    return first, most


def _planes_through(
    points_m: FloatArray, members: Members, direction: FloatArray, voxel_size_m: float
) -> Fits:
    """Least-squares planes; not through few points, along one line, or tilted too far."""
    covariance_m2, centre_m = np.zeros((len(members.counts), 6)), np.zeros((len(members.counts), 3))
    _add_up(points_m, members.rows, members.counts, centre_m, covariance_m2)
    values_m2, vectors = symmetric_eigh(covariance_m2)
    normals = vectors[:, :, 0] * np.where(vectors[:, :, 0] @ direction < 0, -1.0, 1.0)[:, None]
    is_thin = members.counts >= MIN_POINTS
    is_thin &= values_m2[:, 1] >= (MIN_EXTENT_VOXELS * voxel_size_m) ** 2
    is_thin &= normals @ direction >= MAX_TILT_COSINE
    scatter_m = np.sqrt(np.maximum(values_m2[:, 0], 1e-12))
    return Fits(normals, (normals * centre_m).sum(axis=1), scatter_m, is_thin)


@compiled
def _add_up(
    points_m: FloatArray,
    rows: IntArray,
    counts: IntArray,
    centre_m: FloatArray,
    covariance_m2: FloatArray,
) -> None:
    """(P, 3) centres of those of (N, 3) points in (P, M) rows, as many as there are, and (P, 6) xx,
    xy, xz, yy, yz, zz of their covariances, into zeros."""
    for p in range(len(counts)):
        share = 1.0 / max(counts[p], 1)
        c_x, c_y, c_z = 0.0, 0.0, 0.0
        for k in range(counts[p]):
            row = rows[p, k]
            c_x, c_y, c_z = c_x + points_m[row, 0], c_y + points_m[row, 1], c_z + points_m[row, 2]
        c_x, c_y, c_z = c_x * share, c_y * share, c_z * share
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(counts[p]):
            row = rows[p, k]
            x, y, z = points_m[row, 0] - c_x, points_m[row, 1] - c_y, points_m[row, 2] - c_z
            xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
            yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        centre_m[p] = c_x, c_y, c_z
        for entry, total in enumerate((xx, xy, xz, yy, yz, zz)):
            covariance_m2[p, entry] = total * share


@compiled
def _measure(
    points_m: FloatArray,
    rows: IntArray,
    counts: IntArray,
    normals: FloatArray,
    offsets_m: FloatArray,
    away_m: FloatArray,
) -> None:
    """How far those of (N, 3) points in (P, M) rows, as many as there are, lie from P planes, into
    (P, M)."""
    for p in range(len(counts)):
        n_x, n_y, n_z, offset_m = normals[p, 0], normals[p, 1], normals[p, 2], offsets_m[p]
        for k in range(counts[p]):
            row = rows[p, k]
            height_m = n_x * points_m[row, 0] + n_y * points_m[row, 1] + n_z * points_m[row, 2]
            away_m[p, k] = height_m - offset_m


@compiled
def _close_in(
    rows: IntArray, counts: IntArray, away_m: FloatArray, sorted_m: FloatArray, reach_m: float
) -> None:
    """Of those in (P, M) rows, as many as there are, the ones that lie where most do within a reach
    come first, and there are no others, by (P, M) places, as they are and in order."""
    for p in range(len(counts)):
        heap_m, count = 0.0, 0
        if counts[p] > 0:
            heap_m = densest(sorted_m[p, : counts[p]], reach_m)[0]
        for k in range(counts[p]):
            rows[p, count] = rows[p, k]
            count += abs(away_m[p, k] - heap_m) < reach_m
        counts[p] = count
