"""Cylindrical patches: what lies around a voxel, at three scales, seen along its normal.

A cylinder about the voxel's normal is cut into 5 radii x 5 heights x 5 sectors = 125 cells; each
holds the logarithm of the number of voxel centroids in it. The same cylinder is laid over the
Skip-map itself and over two coarser levels of it, so the largest reaches 20 voxels far at the price
of the smallest. The frame's first tangent is arbitrary: turning it about the normal shifts the
sectors cyclically, and whoever compares patches must not care (``learning.descriptor`` does not).
"""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.cells import pack
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

LEVELS = (0, 1, 2)
"""Scales of a patch: points are gathered in voxels of 1, 2 and 4 times the Skip-map's size."""
REACH_VOXELS = 5.0
"""Radius and half-height of a cylinder, in voxels of its level."""
RADII = HEIGHTS = SECTORS = 5
SECTOR_SIZE = RADII * HEIGHTS * len(LEVELS)
"""Numbers that one sector of a patch holds."""
_SLICES = 10
"""Thinner sectors, counted first: a sector takes 3/4 of its own two, 1/4 of one on each side."""
_CHUNK = 1024
"""Voxels described at a time: their pairs stay in the processor's cache."""


def choose_keypoints(skipmap: SkipMap, count: int) -> IntArray:
    """Ascending rows of the ``count`` most curved voxels, of all when there are fewer.

    Flat surroundings look alike: they cost as much as others and show no place in particular.
    """
    return np.sort(np.argsort(-skipmap.curvatures, kind="stable")[:count])


def cylinder_patches(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """Describe voxels by the surfaces around them, in the frame of their normal.

    Args:
        skipmap: the scan's Skip-map; without a viewpoint the sign of a normal is arbitrary, and so
            is the end of the patch that is up (``turned_over``).
        rows: (K,) voxels to describe.

    Returns:
        (K, 5, 75) float32: per sector and scale the logarithm of 1 + the centroids in each of
        5 radii x 5 heights.
    """
    frames = tangent_frames(skipmap, rows)
    scales = [_one_scale(skipmap, rows, frames, level) for level in LEVELS]
    return np.concatenate(scales, axis=2)


def turned_over(patches: FloatArray) -> FloatArray:
    """The (K, 5, 75) patches that the opposite normals would give: upside down and mirrored."""
    cells = patches.reshape(-1, SECTORS, len(LEVELS), RADII, HEIGHTS)
    return cells[:, ::-1, :, :, ::-1].reshape(patches.shape)


def tangent_frames(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """(K, 3, 3) right-handed frames in columns: the normal, two tangents of arbitrary azimuth."""
    normals, tangents = skipmap.axes[rows, :, 0], skipmap.axes[rows, :, 2]
    return np.stack([normals, tangents, np.cross(normals, tangents)], axis=2)


def _one_scale(skipmap: SkipMap, rows: IntArray, frames: FloatArray, level: int) -> FloatArray:
    from scipy.spatial import cKDTree

    size_m = skipmap.voxel_size_m * 2**level
    centre_m = skipmap.centroids_m.mean(axis=0)  # float32 below is exact enough near it
    around = ((_centroids_of_level(skipmap, level) - centre_m) / size_m).astype(np.float32)
    middle = ((skipmap.centroids_m[rows] - centre_m) / size_m).astype(np.float32)
    axes = frames.astype(np.float32)
    tree = cKDTree(around, balanced_tree=False, compact_nodes=False, leafsize=32)
    counts = np.empty((len(rows), SECTORS, RADII * HEIGHTS), dtype=np.float32)
    for start in range(0, len(rows), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        query = cKDTree(middle[chunk], balanced_tree=False, compact_nodes=False, leafsize=32)
        near = query.sparse_distance_matrix(tree, REACH_VOXELS, output_type="ndarray")
        near = near[near["v"] > 0]  # the voxel itself lies in no sector
        owner = near["i"].astype(np.int32)
        offset = around.take(near["j"], axis=0) - middle[chunk].take(owner, axis=0)
        counts[chunk] = _count(owner, offset, axes[chunk])
    return np.log1p(counts)


def _centroids_of_level(skipmap: SkipMap, level: int) -> FloatArray:
    """(W, 3) centroids of the voxels merged by 2^level along each axis, metres."""
    if level == 0:
        return skipmap.centroids_m
    _, merged = np.unique(pack(skipmap.cells >> level), return_inverse=True)
    weighted_m = skipmap.centroids_m * skipmap.counts[:, None]
    total_m = np.stack([np.bincount(merged, column) for column in weighted_m.T], axis=1)
    return total_m / np.bincount(merged, skipmap.counts)[:, None]


def _count(owner: IntArray, offset: FloatArray, frames: FloatArray) -> FloatArray:
    """(K, 5, 25) points per sector, radius and height, soft in the azimuth.

    Args:
        owner: (P,) voxel that each pair belongs to.
        offset: (P, 3) from the voxel to the point, in voxels of the level.
        frames: (K, 3, 3) from ``tangent_frames``.
    """
    x, y, z = offset.T
    axes = frames.reshape(-1, 9).take(owner, axis=0).T
    height, first, second = (x * axes[i] + y * axes[i + 3] + z * axes[i + 6] for i in range(3))
    turn = np.arctan2(second, first) * np.float32(_SLICES / (2 * np.pi))
    slices = (turn + np.float32(_SLICES)).astype(np.int32) % _SLICES
    heights = ((height + REACH_VOXELS) * np.float32(HEIGHTS / (2 * REACH_VOXELS))).astype(np.int32)
    radius = np.sqrt(first * first + second * second)
    radii = (radius * np.float32(RADII / REACH_VOXELS)).astype(np.int32)
    heights, radii = np.minimum(heights, HEIGHTS - 1), np.minimum(radii, RADII - 1)
    cell = ((owner * _SLICES + slices) * RADII + radii) * HEIGHTS + heights
    counts = np.bincount(cell, minlength=len(frames) * _SLICES * RADII * HEIGHTS)
    return _SLICES_TO_SECTORS @ counts.astype(np.float32).reshape(-1, _SLICES, RADII * HEIGHTS)


def _slices_to_sectors() -> FloatArray:
    """(5, 10) shares of the slices in the sectors: triangles two sectors wide; columns sum to 1."""
    gap = (np.arange(_SLICES) + 0.5) * SECTORS / _SLICES - 0.5 - np.arange(SECTORS)[:, None]
    gap = (gap + SECTORS / 2) % SECTORS - SECTORS / 2
    return np.maximum(1 - np.abs(gap), 0).astype(np.float32)


_SLICES_TO_SECTORS = _slices_to_sectors()
