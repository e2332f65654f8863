"""Planes: the primitives that a Skip-map's flat voxels form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.grouping import group_keys
from skipnet.skipmap.moments import Moments, principal_axes
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

FLAT_CURVATURE = 0.02
"""Below it a 3x3x3 neighbourhood is one plane: an edge of 90 degrees has 0.1 and more, noise of 5 %
of a voxel 0.004."""

_DIRECTION_BINS = 12
_GROWN_AT_ONCE = 16
"""Planes that are grown side by side: fewer, longer calls."""


@dataclass(frozen=True)
class Planes:
    """K planes n . x = d in the scan's frame, heaviest first."""

    normals: FloatArray
    """(K, 3) unit normals, towards the sensor where the viewpoint is known."""
    offsets_m: FloatArray
    """(K,) d."""
    centroids_m: FloatArray
    """(K, 3) mean of the supporting voxels."""
    weights: FloatArray
    """(K,) supporting voxels: the visible area in squared voxels."""

    def __len__(self) -> int:
        return len(self.normals)

    def with_both_signs(self) -> Planes:
        """Each plane twice, with its normal and the opposite one: for scans without a viewpoint."""
        return Planes(
            np.concatenate([self.normals, -self.normals]),
            np.concatenate([self.offsets_m, -self.offsets_m]),
            np.concatenate([self.centroids_m, self.centroids_m]),
            np.concatenate([self.weights, self.weights]),
        )


def find_planes(
    skipmap: SkipMap,
    max_planes: int = 40,
    max_angle_rad: float = 0.14,
    max_offset_voxels: float = 1.0,
    min_voxels: int = 12,
) -> Planes:
    """Planes from the flat voxels, by repeated voting on (direction, offset) and a fit to inliers.

    Coplanar patches, such as a wall on both sides of a door, count as one plane.

    Args:
        skipmap: the scan's Skip-map.
        max_planes: stop after that many.
        max_angle_rad: largest angle between a voxel's normal and its plane's.
        max_offset_voxels: largest distance of a voxel's centroid from its plane.
        min_voxels: smallest plane.
    """
    flat = skipmap.curvatures < FLAT_CURVATURE
    centre_m = skipmap.origin_m  # offsets about a near place keep their digits
    points_m = skipmap.centroids_m[flat] - centre_m
    normals = skipmap.normals[flat]
    if skipmap.viewpoint_m is None:
        normals = normals * _shared_sign(normals)[:, None]
    tolerance_m = max_offset_voxels * skipmap.voxel_size_m
    bins = _direction_offset_bins(normals, points_m, 2 * tolerance_m)
    columns = np.ascontiguousarray(points_m.T), np.ascontiguousarray(normals.T)
    free = np.ones(len(points_m), dtype=bool)
    votes = np.bincount(bins)
    found: list[tuple[FloatArray, FloatArray, int]] = []
    while len(found) < max_planes and np.count_nonzero(free) >= min_voxels:
        favourites = np.argsort(-votes, kind="stable")[:_GROWN_AT_ONCE]
        favourites = favourites[votes[favourites] >= min_voxels / 4]
        if len(favourites) == 0:
            break
        seeds = free & (bins == favourites[:, None])
        planes, inliers = _grow_planes(*columns, seeds, tolerance_m, np.cos(max_angle_rad))
        for normal, inlier, seed in zip(planes, inliers, seeds, strict=True):
            if np.count_nonzero(seed & free) < min_voxels / 4:
                continue  # most of it went to a plane before
            inlier &= free
            rows = np.flatnonzero(inlier)
            if len(rows) >= min_voxels:
                found.append((normal, points_m[rows].mean(axis=0) + centre_m, len(rows)))
            free &= ~(inlier | seed)
        votes = np.bincount(bins[free], minlength=len(votes))
    return _as_planes(found[:max_planes])


def _direction_offset_bins(normals: FloatArray, points_m: FloatArray, bin_m: float) -> IntArray:
    """Number of the bin of normal direction and plane offset that each voxel votes for."""
    direction = np.round(normals * (_DIRECTION_BINS / 2)).astype(np.int64)
    snapped = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    offset = np.round(np.einsum("vi,vi->v", snapped, points_m) / bin_m).astype(np.int64)
    column = direction @ np.array([1, 32, 1024]) + (1 << 15)
    return group_keys((column << 40) + offset)[1]


def _grow_planes(
    points_m: FloatArray,
    normals: FloatArray,
    members: BoolArray,
    tolerance_m: float,
    min_cosine: float,
) -> tuple[FloatArray, BoolArray]:
    """Fit planes to some voxels each, then three times to their inliers among all V of them.

    Args:
        points_m: (3, V) centroids.
        normals: (3, V) unit normals.
        members: (P, V) those that each of P planes starts from.
        tolerance_m: largest distance of an inlier.
        min_cosine: smallest cosine between an inlier's normal and the plane's.

    Returns:
        (P, 3) unit normals and the (P, V) inliers.
    """
    plane_normals = _add_up(normals, members)[:, 1:4]
    plane_normals /= np.linalg.norm(plane_normals, axis=1, keepdims=True)
    sums = _sum_members(points_m, members)
    for _ in range(3):
        offsets_m = (plane_normals * sums.mean).sum(axis=1)
        members = _inliers(points_m, normals, plane_normals, offsets_m, tolerance_m, min_cosine)
        sums = _sum_members(points_m, members)
        fitted = principal_axes(sums)[1][:, :, 0]
        fitted *= np.where((fitted * plane_normals).sum(axis=1) >= 0, 1.0, -1.0)[:, None]
        plane_normals = np.where(sums.count[:, None] >= 3, fitted, plane_normals)
    return plane_normals, members


def _sum_members(points_m: FloatArray, members: BoolArray) -> Moments:
    """Moments of P sets of voxels, each counted once; an empty set's are those of a point at 0."""
    sums = _add_up(points_m, members)
    sums[:, 0] = np.maximum(sums[:, 0], 1)
    return Moments(sums)


@compiled
def _inliers(
    points_m: FloatArray,
    normals: FloatArray,
    plane_normals: FloatArray,
    offsets_m: FloatArray,
    tolerance_m: float,
    min_cosine: float,
) -> BoolArray:
    """(P, V) which voxels lie on which planes, with normals that agree."""
    members = np.empty((len(plane_normals), points_m.shape[1]), dtype=np.bool_)
    for p in range(len(plane_normals)):
        n_x, n_y, n_z = plane_normals[p, 0], plane_normals[p, 1], plane_normals[p, 2]
        offset_m = offsets_m[p]
        for v in range(points_m.shape[1]):
            apart_m = n_x * points_m[0, v] + n_y * points_m[1, v] + n_z * points_m[2, v]
            cosine = n_x * normals[0, v] + n_y * normals[1, v] + n_z * normals[2, v]
            members[p, v] = (abs(apart_m - offset_m) < tolerance_m) & (cosine > min_cosine)
    return members


@compiled
def _add_up(points_m: FloatArray, members: BoolArray) -> FloatArray:
    """(P, 10) sums over the members of each set, as in ``Moments``, of (3, V) points."""
    sums = np.zeros((len(members), 10))
    for p in range(len(members)):
        for v in range(members.shape[1]):
            if members[p, v]:
                x, y, z = points_m[0, v], points_m[1, v], points_m[2, v]
                sums[p, 0] += 1
                sums[p, 1] += x
                sums[p, 2] += y
                sums[p, 3] += z
                sums[p, 4] += x * x
                sums[p, 5] += x * y
                sums[p, 6] += x * z
                sums[p, 7] += y * y
                sums[p, 8] += y * z
                sums[p, 9] += z * z
    return sums


def _shared_sign(normals: FloatArray) -> FloatArray:
    """A sign that nearly equal normals share, so that unoriented ones can be averaged."""
    largest = np.abs(normals).argmax(axis=1)
    return np.sign(normals[np.arange(len(normals)), largest])


def _as_planes(found: list[tuple[FloatArray, FloatArray, int]]) -> Planes:
    found = sorted(found, key=lambda plane: -plane[2])
    normals = np.array([normal for normal, _, _ in found]).reshape(-1, 3)
    centroids_m = np.array([centroid_m for _, centroid_m, _ in found]).reshape(-1, 3)
    weights = np.array([float(voxels) for _, _, voxels in found])
    return Planes(normals, (normals * centroids_m).sum(axis=1), centroids_m, weights)
