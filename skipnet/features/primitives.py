"""Planes: the primitives that a Skip-map's flat voxels form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

FLAT_CURVATURE = 0.02
"""Below it a 3x3x3 neighbourhood is one plane: an edge of 90 degrees has 0.1 and more, noise of 5 %
of a voxel 0.004."""

_DIRECTION_BINS = 12


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
    columns_m, normal_columns = np.ascontiguousarray(points_m.T), np.ascontiguousarray(normals.T)
    free = np.ones(len(points_m), dtype=bool)
    votes = np.bincount(bins)
    found: list[tuple[FloatArray, FloatArray, int]] = []
    while len(found) < max_planes and np.count_nonzero(free) >= min_voxels:
        seed = np.flatnonzero(free & (bins == votes.argmax()))
        if len(seed) < min_voxels / 4:
            break
        normal, inlier = _grow_plane(
            columns_m, normal_columns, seed, tolerance_m, np.cos(max_angle_rad)
        )
        inlier = inlier[free[inlier]]
        if len(inlier) >= min_voxels:
            found.append((normal, points_m[inlier].mean(axis=0) + centre_m, len(inlier)))
        taken = np.union1d(inlier, seed)
        free[taken] = False
        votes -= np.bincount(bins[taken], minlength=len(votes))
    return _as_planes(found)


def _direction_offset_bins(normals: FloatArray, points_m: FloatArray, bin_m: float) -> IntArray:
    """Number of the bin of normal direction and plane offset that each voxel votes for."""
    direction = np.round(normals * (_DIRECTION_BINS / 2)).astype(np.int64)
    snapped = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    offset = np.round(np.einsum("vi,vi->v", snapped, points_m) / bin_m).astype(np.int64)
    column = direction @ np.array([1, 32, 1024]) + (1 << 15)
    return np.unique((column << 40) + offset, return_inverse=True)[1]


def _grow_plane(
    points_m: FloatArray,
    normals: FloatArray,
    rows: IntArray,
    tolerance_m: float,
    min_cosine: float,
) -> tuple[FloatArray, IntArray]:
    """Fit a plane to some voxels, then three times to its inliers among all (3, V) of them.

    Returns:
        (3,) unit normal and the rows of the inliers.
    """
    normal = normals.take(rows, axis=1).mean(axis=1)
    normal /= np.linalg.norm(normal)
    for _ in range(3):
        along_m = normal @ points_m
        middle_m = np.partition(along_m.take(rows), len(rows) // 2)[len(rows) // 2]
        near = np.abs(along_m - middle_m) < tolerance_m
        rows = np.flatnonzero(near & (normal @ normals > min_cosine))
        if len(rows) < 3:
            break
        normal = _fit_normal(points_m.take(rows, axis=1), normal)
    return normal, rows


def _fit_normal(points_m: FloatArray, towards: FloatArray) -> FloatArray:
    """Least-squares normal of (3, P) points, on the side of ``towards``."""
    centred = points_m - points_m.mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(centred @ centred.T)[1][:, 0]
    return normal if normal @ towards >= 0 else -normal


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
