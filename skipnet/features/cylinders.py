"""Cylindrical patches: what lies around a voxel, at two scales, seen along its surface's axis.

A cylinder about the axis is cut into 5 radii x 5 heights x 5 sectors = 125 cells; each holds two
logarithms: of the number of voxel centroids in it whose surface lies along the voxel's own, and of
the number of those whose surface lies across it. The same cylinder is laid over two coarser levels
of the Skip-map, so the larger reaches 20 voxels far at the price of the smaller. The frame's first
tangent is arbitrary: turning it about the axis shifts the sectors cyclically, and whoever compares
patches must not care (``learning.descriptor`` does not).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.features.descriptors import factors_of_squared_distances
from skipnet.features.frames import Level, level_of, outer_products, tangent_frames
from skipnet.skipmap.cells import pack, unpack
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

LEVELS = (1, 2)
"""Scales of a patch: points are gathered in voxels of 2 and 4 times the Skip-map's size."""
REACH_VOXELS = 5.0
"""Radius and half-height of a cylinder, in voxels of its level."""
RADII = HEIGHTS = SECTORS = 5
KINDS = 2
"""Surfaces along the voxel's own, within 45 degrees, and across it."""
SECTOR_SIZE = len(LEVELS) * KINDS * RADII * HEIGHTS
"""Numbers that one sector of a patch holds."""
_SLICES = 10
"""Thinner sectors, counted first: a sector takes 3/4 of its own two, 1/4 of one on each side."""
_BINS = _SLICES * KINDS * RADII * HEIGHTS
_OUTSIDE, _BINS_AND_OUTSIDE = 511, 512
_GRID = 60
"""Places per axis, across the cylinder, for which the bin is looked up: a sixth of a voxel each."""
_PLACES = _GRID + 2
_FAR_VOXELS = 1e4
"""Where the row that fills up a list lies: outside every cylinder."""
_LIST_REACH_VOXELS = REACH_VOXELS + 3**0.5 / 2
"""Beyond the cylinder's, from a cell's centre to its corners."""
_DISTANCES_AT_ONCE = 1 << 18
_CHUNK = 256
"""Voxels described at a time: their pairs stay in the processor's cache."""


def choose_keypoints(skipmap: SkipMap, count: int) -> IntArray:
    """Ascending rows of the ``count`` most curved voxels, of all when there are fewer.

    Flat surroundings look alike: they cost as much as others and show no place in particular.
    """
    return np.sort(np.argsort(-skipmap.curvatures, kind="stable")[:count])


def cylinder_patches(skipmap: SkipMap, rows: IntArray) -> FloatArray:
    """Describe voxels by the surfaces around them, in the frame of their own.

    Args:
        skipmap: the scan's Skip-map; without a viewpoint the sign of a normal is arbitrary, and so
            is the end of the patch that is up (``turned_over``).
        rows: (K,) voxels to describe.

    Returns:
        (K, 5, 100) float32: per sector, scale and kind of surface the logarithm of 1 + the
        centroids in each of 5 radii x 5 heights.
    """
    if len(rows) == 0:
        return np.zeros((0, SECTORS, SECTOR_SIZE), dtype=np.float32)
    levels = [level_of(skipmap)]
    for _ in range(max(LEVELS)):
        levels.append(levels[-1].coarser())
    frames = tangent_frames(skipmap, rows, levels[1])
    scales = [_one_scale(skipmap, rows, frames, levels[level]) for level in LEVELS]
    return np.concatenate(scales, axis=2)


def turned_over(patches: FloatArray) -> FloatArray:
    """The (K, 5, 100) patches that the opposite axes would give: upside down and mirrored."""
    cells = patches.reshape(len(patches), SECTORS, -1, HEIGHTS)
    return cells[:, ::-1, :, ::-1].reshape(patches.shape)


def _one_scale(skipmap: SkipMap, rows: IntArray, frames: FloatArray, level: Level) -> FloatArray:
    """(K, 5, 50) one scale of the patches."""
    middle = level.places(skipmap.centroids_m[rows]).astype(np.float32)
    around = _around(level)
    near = _neighbours(middle, around[:-1, :3])
    to_places = _to_places(middle, frames.astype(np.float32))
    scale = np.empty((len(rows), SECTORS, _BINS // _SLICES), dtype=np.float32)
    sizes = near.sizes[near.group].astype(np.uint16)  # short numbers are sorted by radix
    by_size = np.argsort(sizes, kind="stable")
    for start in range(0, len(rows), _CHUNK):
        chunk = by_size[start : start + _CHUNK]
        listed = near.lists[near.group[chunk], : sizes[chunk[-1]]]
        slices = _count(around.take(listed, axis=0), to_places[chunk])
        scale[chunk] = np.log(1 + _SLICES_TO_SECTORS @ slices)
    return scale


def _around(level: Level) -> FloatArray:
    """(W + 1, 10) float32 centroids, 1, and the normals' alignment; the last row is far away."""
    count = len(level.moments)
    around = np.zeros((count + 1, 10), dtype=np.float32)
    around[:count, :3] = level.moments.mean
    around[count, :3] = _FAR_VOXELS
    around[:, 3] = 1
    around[:count, 4:] = level.alignment
    return around


@dataclass(frozen=True)
class _Near:
    """What may lie in the cylinders: voxels of one cell of the level share one list."""

    group: IntArray
    """(K,) each voxel's list."""
    lists: IntArray
    """(G, L) rows of what lies around, filled up with the one that is far away."""
    sizes: IntArray
    """(G,) rows that are not filled up."""


def _neighbours(middle: FloatArray, around: FloatArray) -> _Near:
    """The lists of (K, 3) voxels to describe among (W, 3) points, in voxels of the level.

    A level has hundreds or a few thousand voxels: measuring all distances is quicker than a tree.
    """
    keys, group = np.unique(pack(np.floor(middle).astype(np.int64)), return_inverse=True)
    centres = (unpack(keys) + 0.5).astype(np.float32)
    left, right = factors_of_squared_distances(centres, around)
    # Far from the middle float32 errs more; what is listed in vain is not counted.
    error = 8 * np.finfo(np.float32).eps * float(right[-1].max(initial=0.0))
    rows, sizes = [np.zeros(0, dtype=np.int32)], np.zeros(len(keys), dtype=np.int64)
    step = max(1, _DISTANCES_AT_ONCE // max(1, len(around)))
    for start in range(0, len(keys), step):
        near = left[start : start + step] @ right < _LIST_REACH_VOXELS**2 + error
        size = sizes[start : start + step] = np.count_nonzero(near, axis=1)
        firsts = np.repeat(np.arange(len(near)) * len(around), size)
        rows.append((np.flatnonzero(near) - firsts).astype(np.int32))
    lists = np.full((len(keys), sizes.max(initial=0)), len(around), dtype=np.int32)
    lists[np.arange(lists.shape[1]) < sizes[:, None]] = np.concatenate(rows)
    return _Near(group, lists, sizes)


def _to_places(middle: FloatArray, frames: FloatArray) -> FloatArray:
    """(K, 10, 4) maps of what lies around to each voxel's grid of places, and to its kind.

    Inside the cylinder a place is 1 to 61 along each axis. The kind, 0 to a little less than 2, is
    twice the squared cosine between the surface and the voxel's own.
    """
    turned = frames * np.float32(_GRID / (2 * REACH_VOXELS))
    maps = np.zeros((len(middle), 10, 4), dtype=np.float32)
    maps[:, :3, :3] = turned
    maps[:, 3, :3] = _GRID / 2 + 1 - np.matmul(middle[:, None], turned)[:, 0]
    maps[:, 4:, 3] = 1.9999 * outer_products(frames[:, :, 0])
    return maps


def _count(near: FloatArray, to_places: FloatArray) -> FloatArray:
    """(C, 10, 50) centroids per slice, of (C, L, 10) what lies around and (C, 10, 4) maps."""
    places = near @ to_places
    np.clip(places, 0, _GRID + 1, out=places)
    np.floor(places, out=places)
    place = (places @ _STRIDES).astype(np.int32)  # exact: below 2^24
    bins = np.arange(len(near), dtype=np.int32)[:, None] * _BINS_AND_OUTSIDE
    bins = bins + _BIN_OF_PLACE.take(place)
    counts = np.bincount(bins.ravel(), minlength=len(near) * _BINS_AND_OUTSIDE)
    inside = counts.reshape(-1, _BINS_AND_OUTSIDE)[:, :_BINS]
    return inside.reshape(len(near), _SLICES, -1).astype(np.float32)


def _bin_of_place() -> IntArray:
    """(2 * 62^3,) uint16: slice, kind, radius and height where the middle of each place lies.

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
    kinds = np.array([1, 0])[:, None, None, None]  # those along the voxel's own come first
    bins = ((slices * KINDS + kinds) * RADII + radii) * HEIGHTS + heights
    return np.where(counted, bins, _OUTSIDE).astype(np.uint16).ravel()


def _slices_to_sectors() -> FloatArray:
    """(5, 10) shares of the slices in the sectors: triangles two sectors wide; columns sum to 1."""
    gap = (np.arange(_SLICES) + 0.5) * SECTORS / _SLICES - 0.5 - np.arange(SECTORS)[:, None]
    gap = (gap + SECTORS / 2) % SECTORS - SECTORS / 2
    return np.maximum(1 - np.abs(gap), 0).astype(np.float32)


_BIN_OF_PLACE = _bin_of_place()
_SLICES_TO_SECTORS = _slices_to_sectors()
_STRIDES = np.array([_PLACES**2, _PLACES, 1, _PLACES**3], dtype=np.float32)
