"""Cylindrical patches: what lies around a voxel, at two scales, seen along its surface's axis.

A cylinder about the axis is cut into 5 radii x 5 heights x 5 sectors = 125 cells; each holds two
logarithms: of the number of voxel centroids in it whose surface lies along the voxel's own, and of
the number of those whose surface lies across it. The same cylinder is laid over two coarser levels
of the Skip-map, so the larger reaches 20 voxels far at the price of the smaller. The frame's first
tangent is arbitrary: turning it about the axis shifts the sectors cyclically, and whoever compares
patches must not care (``learning.descriptor`` does not).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.frames import Level, level_of, outer_products, runs_around, tangent_frames
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
_OUTSIDE = _BINS
_GRID = 60
"""Places per axis, across the cylinder, for which the bin is looked up: a sixth of a voxel each."""
_PLACES = _GRID + 2
"""With one on each side for all that is outside."""
_OUTER_REACH_VOXELS = REACH_VOXELS * (1 + 3**0.5 / _GRID)
"""Beyond it lies no place of which the middle is in the cylinder."""


def choose_keypoints(skipmap: SkipMap, count: int, curved_share: float = 1.0) -> IntArray:
    """Ascending rows of the most curved voxels, of all when there are fewer than ``count``.

    Flat surroundings look alike: they cost as much as others and show no place in particular. Yet
    where two scans share little the most curved voxels of one may all lie outside the other.

    Args:
        skipmap: of one scan.
        count: voxels.
        curved_share: so many of them are the most curved ones; the others are taken evenly from the
            order of the rest.
    """
    order = np.argsort(-skipmap.curvatures, kind="stable")
    if len(order) <= count:
        return np.sort(order)
    curved = int(curved_share * count)
    others = np.linspace(curved, len(order) - 1, count - curved).astype(np.int64)
    return np.sort(np.concatenate([order[:curved], order[others]]))


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
    middle = level.places(skipmap.centroids_m[rows])
    order, first, last = runs_around(middle, level.moments.mean, _OUTER_REACH_VOXELS)
    turned = frames * (_GRID / (2 * REACH_VOXELS))
    kind = 1.9999 * outer_products(frames[:, :, 0])
    around = np.concatenate([level.moments.mean, level.alignment], axis=1)[order]
    sectors = np.empty((len(rows), SECTORS, _BINS // _SLICES), dtype=np.float32)
    _count(
        middle.astype(np.float32),
        turned.astype(np.float32),
        kind.astype(np.float32),
        np.ascontiguousarray(around.T, dtype=np.float32),
        first,
        last,
        _bin_of_place(),
        sectors,
    )
    return np.log(sectors, out=sectors)


@compiled
def _add_slices(slices: IntArray, sectors: FloatArray) -> None:
    """1 + what each of a voxel's (5, 50) sectors takes of its (501,) counts by slice."""
    within, beside = np.float32(0.75), np.float32(0.25)
    size = sectors.shape[1]
    for sector in range(SECTORS):
        first = 2 * sector * size
        before, after = (first - size) % _BINS, (first + 2 * size) % _BINS
        # Slices of their own: then the compiler takes several bins at a time.
        own, other = slices[first : first + size], slices[first + size : first + 2 * size]
        last, following = slices[before : before + size], slices[after : after + size]
        filled = sectors[sector]
        for b in range(len(filled)):
            inner = np.float32(own[b] + other[b])
            outer = np.float32(last[b] + following[b])
            filled[b] = np.float32(1) + (within * inner + beside * outer)


@compiled
def _count(
    middle: FloatArray,
    frames: FloatArray,
    own: FloatArray,
    around: FloatArray,
    first: IntArray,
    last: IntArray,
    bin_of_place: IntArray,
    sectors: FloatArray,
) -> None:
    """Count what lies around (K, 3) voxels, by slice, kind, radius and height, and add the slices.

    Where each one lies is worked out for all of a run, several at a time; to leave some out would
    take longer. The counts of one voxel at a time stay in the processor's cache.

    Args:
        middle: float32 the voxels, in those of the level.
        frames: (K, 3, 3) their axes and two tangents, in columns, as long as there are places.
        own: (K, 6) ``outer_products`` of their axes, times twice a little less than 1.
        around, first, last, bin_of_place: of ``runs_around`` and of ``_bin_of_place``.
        sectors: (K, 5, 50) to fill.
    """
    counts = np.empty(_BINS + 1, dtype=np.int32)  # the last one is of what is outside
    places = np.empty(around.shape[1], dtype=np.int32)
    side, most_kind = np.int32(_PLACES), np.float32(KINDS - 1)
    least, most, half = np.float32(0), np.float32(_GRID + 1), np.float32(_GRID / 2 + 1)
    for k in range(len(middle)):
        x_k, y_k, z_k = middle[k, 0], middle[k, 1], middle[k, 2]
        h_x, h_y, h_z = frames[k, 0, 0], frames[k, 1, 0], frames[k, 2, 0]
        u_x, u_y, u_z = frames[k, 0, 1], frames[k, 1, 1], frames[k, 2, 1]
        v_x, v_y, v_z = frames[k, 0, 2], frames[k, 1, 2], frames[k, 2, 2]
        k_xx, k_xy, k_xz = own[k, 0], own[k, 1], own[k, 2]
        k_yy, k_yz, k_zz = own[k, 3], own[k, 4], own[k, 5]
        counts[:] = 0
        for run in range(3):
            start, stop = first[k, run], last[k, run]
            x_s, y_s, z_s = around[0, start:stop], around[1, start:stop], around[2, start:stop]
            xx, xy, xz = around[3, start:stop], around[4, start:stop], around[5, start:stop]
            yy, yz, zz = around[6, start:stop], around[7, start:stop], around[8, start:stop]
            for w in range(len(x_s)):
                x, y, z = x_s[w] - x_k, y_s[w] - y_k, z_s[w] - z_k
                h = np.int32(min(most, max(least, x * h_x + y * h_y + z * h_z + half)))
                u = np.int32(min(most, max(least, x * u_x + y * u_y + z * u_z + half)))
                v = np.int32(min(most, max(least, x * v_x + y * v_y + z * v_z + half)))
                places[w] = (h * side + u) * side + v
            for w in range(len(x_s)):
                # Twice the mean squared cosine between the surface and the voxel's own.
                kind = xx[w] * k_xx + xy[w] * k_xy + xz[w] * k_xz
                kind += yy[w] * k_yy + yz[w] * k_yz + zz[w] * k_zz
                places[w] += np.int32(min(most_kind, max(least, kind))) * (side * side * side)
            for w in range(len(x_s)):
                counts[bin_of_place[places[w]]] += 1
        _add_slices(counts, sectors[k])


@cache
def _bin_of_place() -> IntArray:
    """(2 * 62^3,) uint16: slice, kind, radius and height where the middle of each place lies.

    Computing them anew for every pair, arctangent and root, would take most of the time. Outside
    the ball, and where the voxel itself lies, nothing is counted.
    """
    middles = ((np.arange(-1, _GRID + 1) + 0.5) / _GRID * 2 - 1) * REACH_VOXELS
    height, first, second = np.meshgrid(middles, middles, middles, indexing="ij", sparse=True)
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
