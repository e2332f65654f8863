"""Planes: the primitives that a Skip-map's flat voxels form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    surfaces = _Surfaces.of(points_m, normals)
    free = np.ones(len(points_m), dtype=bool)
    votes = np.bincount(bins)
    found: list[tuple[FloatArray, FloatArray, int]] = []
    while len(found) < max_planes and np.count_nonzero(free) >= min_voxels:
        favourites = np.argsort(-votes, kind="stable")[:_GROWN_AT_ONCE]
        favourites = favourites[votes[favourites] >= min_voxels / 4]
        if len(favourites) == 0:
            break
        seeds = free & (bins == favourites[:, None])
        planes, inliers = _grow_planes(surfaces, seeds, tolerance_m, np.cos(max_angle_rad))
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
    return np.unique((column << 40) + offset, return_inverse=True)[1]


@dataclass(frozen=True)
class _Surfaces:
    """V flat voxels by coordinate, which is how they are computed with."""

    points_m: FloatArray
    """(3, V)."""
    normals: FloatArray
    """(3, V)."""
    figures: FloatArray
    """(V, 10) what adds up to a plane: 1, the coordinates, and their six products."""

    @staticmethod
    def of(points_m: FloatArray, normals: FloatArray) -> _Surfaces:
        """Of (V, 3) centroids and normals."""
        x_m, y_m, z_m = columns_m = np.ascontiguousarray(points_m.T)
        six = (x_m * x_m, x_m * y_m, x_m * z_m, y_m * y_m, y_m * z_m, z_m * z_m)
        figures = np.stack([np.ones(len(points_m)), *columns_m, *six], axis=1)
        return _Surfaces(columns_m, np.ascontiguousarray(normals.T), figures)


def _grow_planes(
    surfaces: _Surfaces, members: BoolArray, tolerance_m: float, min_cosine: float
) -> tuple[FloatArray, BoolArray]:
    """Fit planes to some voxels each, then three times to their inliers among all V of them.

    Args:
        surfaces: the voxels.
        members: (P, V) those that each of P planes starts from.
        tolerance_m: largest distance of an inlier.
        min_cosine: smallest cosine between an inlier's normal and the plane's.

    Returns:
        (P, 3) unit normals and the (P, V) inliers.
    """
    normals = members @ surfaces.normals.T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sums = _add_up(surfaces, members)
    for _ in range(3):
        middle_m = (normals * sums.mean).sum(axis=1)
        near = np.abs(normals @ surfaces.points_m - middle_m[:, None]) < tolerance_m
        members = near & (normals @ surfaces.normals > min_cosine)
        sums = _add_up(surfaces, members)
        fitted = principal_axes(sums)[1][:, :, 0]
        fitted *= np.where((fitted * normals).sum(axis=1) >= 0, 1.0, -1.0)[:, None]
        normals = np.where(sums.count[:, None] >= 3, fitted, normals)
    return normals, members


def _add_up(surfaces: _Surfaces, members: BoolArray) -> Moments:
    """Moments of P sets of voxels, each counted once; an empty set's are those of a point at 0."""
    sums = members @ surfaces.figures
    sums[:, 0] = np.maximum(sums[:, 0], 1)
    return Moments(np.ascontiguousarray(sums.T))


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
