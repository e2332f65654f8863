"""Cylindrical patches: what lies around a voxel, at two scales, seen along its normal.

A cylinder about the voxel's normal is cut into 5 radii x 5 heights x 5 sectors = 125 cells; each
holds the logarithm of the number of voxel centroids in it. The same cylinder is laid over two
coarser levels of the Skip-map, so the larger reaches 20 voxels far at the price of the smaller. The
frame's first tangent is arbitrary: turning it about the normal shifts the sectors cyclically, and
whoever compares patches must not care (``learning.descriptor`` does not).
"""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.cells import pack, unpack
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

LEVELS = (1, 2)
"""Scales of a patch: points are gathered in voxels of 2 and 4 times the Skip-map's size."""
REACH_VOXELS = 5.0
"""Radius and half-height of a cylinder, in voxels of its level."""
RADII = HEIGHTS = SECTORS = 5
SECTOR_SIZE = RADII * HEIGHTS * len(LEVELS)
"""Numbers that one sector of a patch holds."""
_SLICES = 10
"""Thinner sectors, counted first: a sector takes 3/4 of its own two, 1/4 of one on each side."""
_BINS = _SLICES * RADII * HEIGHTS
_OUTSIDE, _BINS_AND_OUTSIDE = 255, 256
_GRID = 60
"""Places per axis, across the cylinder, for which the bin is looked up: a sixth of a voxel each."""
_FAR_VOXELS = 1e4
"""Where the rows that fill up a list lie: outside every cylinder."""
_CHUNK = 256
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
        (K, 5, 50) float32: per sector and scale the logarithm of 1 + the centroids in each of
        5 radii x 5 heights.
    """
    frames = tangent_frames(skipmap, rows)
    scales = [_one_scale(skipmap, rows, frames, level) for level in LEVELS]
    return np.concatenate(scales, axis=2)


def turned_over(patches: FloatArray) -> FloatArray:
    """The (K, 5, 50) patches that the opposite normals would give: upside down and mirrored."""
    cells = patches.reshape(-1, SECTORS, len(LEVELS), RADII, HEIGHTS)
    return cells[:, ::-1, :, :, ::-1].reshape(patches.shape)


def tangent_frames(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """(K, 3, 3) right-handed frames in columns: the normal, two tangents of arbitrary azimuth."""
    normals, tangents = skipmap.axes[rows, :, 0], skipmap.axes[rows, :, 2]
    return np.stack([normals, tangents, np.cross(normals, tangents)], axis=2)


def _one_scale(skipmap: SkipMap, rows: IntArray, frames: FloatArray, level: int) -> FloatArray:
    """(K, 5, 25) one scale of the patches."""
    size_m = skipmap.voxel_size_m * 2**level
    centre_m = skipmap.centroids_m.mean(axis=0)  # float32 below is exact enough near it
    around = ((_centroids_of_level(skipmap, level) - centre_m) / size_m).astype(np.float32)
    middle = ((skipmap.centroids_m[rows] - centre_m) / size_m).astype(np.float32)
    group, near, sizes = _neighbours(middle, around)
    to_places = _affine_to_places(middle, frames.astype(np.float32))
    counts = np.empty((len(rows), _BINS), dtype=np.float32)
    by_size = np.argsort(sizes[group], kind="stable")
    for start in range(0, len(rows), _CHUNK):
        chunk = by_size[start : start + _CHUNK]
        longest = sizes[group[chunk[-1]]]
        counts[chunk] = _count(near[group[chunk], :longest], to_places[chunk])
    return np.log1p(_SLICES_TO_SECTORS @ counts.reshape(-1, _SLICES, RADII * HEIGHTS))


def _centroids_of_level(skipmap: SkipMap, level: int) -> FloatArray:
    """(W, 3) centroids of the voxels merged by 2^level along each axis, metres."""
    _, merged = np.unique(pack(skipmap.cells >> level), return_inverse=True)
    weighted_m = skipmap.centroids_m * skipmap.counts[:, None]
    total_m = np.stack([np.bincount(merged, column) for column in weighted_m.T], axis=1)
    return total_m / np.bincount(merged, skipmap.counts)[:, None]


def _neighbours(middle: FloatArray, around: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """What may lie in the cylinders: voxels of one cell of the level share one list of points.

    Args:
        middle: (K, 3) voxels to describe, in voxels of the level.
        around: (W, 3) points to be counted.

    Returns:
        (K,) each voxel's list, (G, L, 4) lists of homogeneous points, filled up with far ones, and
        (G,) their lengths.
    """
    from scipy.spatial import cKDTree

    cells = np.floor(middle).astype(np.int64)
    keys, group = np.unique(pack(cells), return_inverse=True)
    centres = unpack(keys) + 0.5
    trees = [
        cKDTree(points, balanced_tree=False, compact_nodes=False, leafsize=32)
        for points in (centres, around)
    ]
    reach = REACH_VOXELS + np.sqrt(3) / 2  # from a cell's centre to its corners
    near = trees[0].sparse_distance_matrix(trees[1], reach, output_type="coo_matrix").tocsr()
    sizes = np.diff(near.indptr)
    place = np.arange(len(near.indices)) - np.repeat(near.indptr[:-1], sizes)
    lists = np.full((len(keys), sizes.max(initial=0), 4), _FAR_VOXELS, dtype=np.float32)
    lists[np.repeat(np.arange(len(keys)), sizes), place, :3] = around[near.indices]
    lists[:, :, 3] = 1
    return group, lists, sizes


def _affine_to_places(middle: FloatArray, frames: FloatArray) -> FloatArray:
    """(K, 4, 3) maps of homogeneous points to each voxel's grid of places, from 1 to 61 inside."""
    turned = frames * np.float32(_GRID / (2 * REACH_VOXELS))
    shift = _GRID / 2 + 1 - np.matmul(middle[:, None], turned)
    return np.concatenate([turned, shift], axis=1).astype(np.float32)


def _count(near: FloatArray, to_places: FloatArray) -> FloatArray:
    """(C, 250) points per slice, radius and height, of (C, L, 4) points and (C, 4, 3) maps."""
    places = near @ to_places
    np.clip(places, 0, _GRID + 1, out=places)
    np.floor(places, out=places)
    place = (places @ _STRIDES).astype(np.int32)  # exact: below 2^24
    bins = np.arange(len(near), dtype=np.int32)[:, None] * _BINS_AND_OUTSIDE
    bins = bins + _BIN_OF_PLACE.take(place)
    counts = np.bincount(bins.ravel(), minlength=len(near) * _BINS_AND_OUTSIDE)
    return counts.reshape(-1, _BINS_AND_OUTSIDE)[:, :_BINS].astype(np.float32)


def _bin_of_place() -> IntArray:
    """(62^3,) uint8: the slice, radius and height in which the middle of each place lies.

    Computing them anew for every pair, arctangent and root, would take most of the time. Outside
    the ball, and where the voxel itself lies, nothing is counted.
    """
    middles = ((np.arange(-1, _GRID + 1) + 0.5) / _GRID * 2 - 1) * REACH_VOXELS
    height, first, second = np.meshgrid(middles, middles, middles, indexing="ij")
    turn = np.arctan2(second, first) / (2 * np.pi) % 1
    slices = np.minimum((turn * _SLICES).astype(np.int32), _SLICES - 1)
    radius = np.hypot(first, second)
    radii = np.minimum((radius * (RADII / REACH_VOXELS)).astype(np.int32), RADII - 1)
    heights = ((height + REACH_VOXELS) * (HEIGHTS / (2 * REACH_VOXELS))).astype(np.int32)
    distance = np.hypot(radius, height)
    counted = (distance < REACH_VOXELS) & (distance > 2 * REACH_VOXELS / _GRID)
    bins = (slices * RADII + radii) * HEIGHTS + heights
    return np.where(counted, bins, _OUTSIDE).astype(np.uint8).ravel()


def _slices_to_sectors() -> FloatArray:
    """(5, 10) shares of the slices in the sectors: triangles two sectors wide; columns sum to 1."""
    gap = (np.arange(_SLICES) + 0.5) * SECTORS / _SLICES - 0.5 - np.arange(SECTORS)[:, None]
    gap = (gap + SECTORS / 2) % SECTORS - SECTORS / 2
    return np.maximum(1 - np.abs(gap), 0).astype(np.float32)


_BIN_OF_PLACE = _bin_of_place()
_SLICES_TO_SECTORS = _slices_to_sectors()
_STRIDES = np.array([(_GRID + 2) ** 2, _GRID + 2, 1], dtype=np.float32)
