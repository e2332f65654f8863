"""Corner points and edge lines from classified feature voxels.

A voxel tells its class and roughly where it is; the flat voxels around it tell exactly where their
surfaces meet. The point nearest to all their planes is the corner, or the foot on the edge (the
normal equations of Foerstner & Gulch's corner operator, in space).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

_REACH = 3
"""Planes within so many voxels meet at a corner."""


@dataclass(frozen=True)
class Corners:
    """K corners of a scan, surest first."""

    points_m: FloatArray
    """(K, 3) where the surfaces meet, scan frame."""
    classes: IntArray
    """(K,) FeatureClass: one of the three corner classes."""
    weights: FloatArray
    """(K,) probability of the class, 0 to 1."""

    def __len__(self) -> int:
        return len(self.points_m)


@dataclass(frozen=True)
class Lines:
    """K straight edges of a scan, longest first."""

    points_m: FloatArray
    """(K, 3) the middle of each edge, scan frame."""
    directions: FloatArray
    """(K, 3) unit, either sign."""
    weights: FloatArray
    """(K,) supporting voxels: the visible length in voxels."""

    def __len__(self) -> int:
        return len(self.points_m)


def find_corners(
    skipmap: SkipMap,
    rows: IntArray,
    classes: IntArray,
    probabilities: FloatArray,
    max_corners: int = 80,
) -> Corners:
    """One corner per group of corner voxels: the surest, moved to where its surfaces meet.

    Args:
        skipmap: the scan's Skip-map.
        rows: (C,) voxels classified as corners.
        classes: (C,) their classes.
        probabilities: (C,) of these classes.
        max_corners: the surest are kept.
    """
    points_m = skipmap.centroids_m[rows]
    left = np.argsort(-probabilities, kind="stable")
    kept: list[int] = []
    while len(left) and len(kept) < max_corners:
        kept.append(int(left[0]))
        apart_m = np.abs(points_m[left] - points_m[left[0]]).max(axis=1)
        left = left[apart_m > 2.5 * skipmap.voxel_size_m]
    chosen = np.array(kept, dtype=np.int64)
    met_m = _meeting_points(skipmap, rows[chosen])
    return Corners(met_m, classes[chosen], probabilities[chosen])


def find_lines(skipmap: SkipMap, rows: IntArray, max_lines: int = 40, min_voxels: int = 5) -> Lines:
    """Straight edges from edge voxels, longest first.

    Args:
        skipmap: the scan's Skip-map.
        rows: (E,) voxels classified as edges.
        max_lines: the longest are kept.
        min_voxels: the shortest edge.
    """
    points_m = _meeting_points(skipmap, rows)
    directions = skipmap.directions[rows]
    free = np.ones(len(rows), dtype=bool)
    support = _neighbours_along(points_m, directions, skipmap.voxel_size_m)
    found: list[tuple[FloatArray, FloatArray, int]] = []
    for seed in np.argsort(-support, kind="stable"):
        if support[seed] < min_voxels or len(found) >= 2 * max_lines:
            break
        if not free[seed]:
            continue
        middle_m, direction, inlier = _grow_line(
            points_m, directions, free, seed, skipmap.voxel_size_m
        )
        if inlier.sum() >= min_voxels:
            found.append((middle_m, direction, int(inlier.sum())))
        free &= ~inlier
        free[seed] = False
    found = sorted(found, key=lambda line: -line[2])[:max_lines]
    return Lines(
        np.array([middle_m for middle_m, _, _ in found]).reshape(-1, 3),
        np.array([direction for _, direction, _ in found]).reshape(-1, 3),
        np.array([float(voxels) for _, _, voxels in found]),
    )


def _meeting_points(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """(K, 3) points nearest to the planes of the flat voxels around each row.

    Directions that those planes leave open (along an edge) keep the voxel's own centroid; a point
    never leaves its voxel's neighbourhood.
    """
    steps = np.stack(np.meshgrid(*[np.arange(-_REACH, _REACH + 1)] * 3, indexing="ij"), axis=-1)
    near = skipmap.find_around(rows, steps.reshape(-1, 3))
    owner, slot = np.nonzero(near >= 0)
    voxel = near[owner, slot]
    flat = skipmap.curvatures[voxel] < 0.02
    owner, voxel = owner[flat], voxel[flat]
    normals = skipmap.normals[voxel]
    offset_m = skipmap.centroids_m[voxel] - skipmap.centroids_m[rows[owner]]
    projector = normals[:, :, None] * normals[:, None, :]
    pull = normals * np.einsum("vi,vi->v", normals, offset_m)[:, None]
    matrix, vector = np.zeros((len(rows), 3, 3)), np.zeros((len(rows), 3))
    for i in range(3):
        vector[:, i] = np.bincount(owner, pull[:, i], len(rows))
        for j in range(3):
            matrix[:, i, j] = np.bincount(owner, projector[:, i, j], len(rows))
    matrix += 0.5 * np.eye(3)  # half a flat voxel's say for the centroid itself
    shift_m = np.linalg.solve(matrix, vector[..., None])[..., 0]
    limit_m = 1.5 * skipmap.voxel_size_m
    length_m = np.linalg.norm(shift_m, axis=1, keepdims=True)
    shift_m *= np.minimum(1, limit_m / np.maximum(length_m, 1e-12))
    return skipmap.centroids_m[rows] + shift_m


def _neighbours_along(
    points_m: FloatArray, directions: FloatArray, voxel_size_m: float
) -> FloatArray:
    """(E,) how many points within 8 voxels lie on the line through each point."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points_m).query_pairs(8 * voxel_size_m, output_type="ndarray")
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    offset_m = points_m[second] - points_m[first]
    aside_m = np.linalg.norm(np.cross(offset_m, directions[first]), axis=1)
    parallel = np.abs(np.einsum("pi,pi->p", directions[first], directions[second])) > 0.94
    on_line = parallel & (aside_m < 0.8 * voxel_size_m)
    return np.bincount(first[on_line], minlength=len(points_m)).astype(np.float64)


def _grow_line(
    points_m: FloatArray, directions: FloatArray, free: BoolArray, seed: int, voxel_size_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Fit a line to the seed's direction, then to its inliers; middle, direction and inliers."""
    middle_m, direction = points_m[seed], directions[seed]
    inlier = np.zeros(len(points_m), dtype=bool)
    for reach_voxels in (8, 16, 60):
        offset_m = points_m - middle_m
        along_m = offset_m @ direction
        aside_m = np.linalg.norm(offset_m - along_m[:, None] * direction, axis=1)
        inlier = free & (np.abs(directions @ direction) > 0.9) & (aside_m < voxel_size_m)
        inlier &= np.abs(along_m) < reach_voxels * voxel_size_m
        if inlier.sum() < 3:
            break
        middle_m = points_m[inlier].mean(axis=0)
        centred = points_m[inlier] - middle_m
        direction = np.linalg.eigh(centred.T @ centred)[1][:, 2]
    return middle_m, direction, inlier
