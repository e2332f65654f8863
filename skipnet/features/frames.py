"""Coarser levels of a Skip-map, and at each voxel the frame of the surface around it.

The normal of a voxel comes from 3x3x3 voxels: at corners and on clutter, where keypoints are, two
scans rarely agree on it. The axis here is the normal of all that lies within 5 voxels, which they
do: on real pairs it came out within 18 degrees in 69 of 100 keypoints, where voxels' own normals do
in 39.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.cells import halve
from skipnet.skipmap.grouping import group_keys
from skipnet.skipmap.moments import Moments, add_up, moments_of_points, principal_axes
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

FRAME_REACH_VOXELS = 2.5
"""The frame is read off voxels of twice the Skip-map's size that are nearer than so many sizes."""
_FAR = 1e7
"""Voxels; no scan is as wide."""
_ROW, _COLUMN = np.triu_indices(3)
_IN_TWICE_THE_VOXEL = 0.5 ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
"""What turns a voxel's moments into those in units of a voxel twice as wide."""
_TWICE = np.where(_ROW == _COLUMN, 1.0, 2.0)
"""How often each of xx, xy, xz, yy, yz, zz stands in a symmetric matrix."""


@dataclass(frozen=True)
class Level:
    """The W voxels of one level; lengths in its own voxels, from ``centre_m``."""

    size_m: float
    centre_m: FloatArray
    """(3,) in the scan's frame: near it float32 is exact enough."""
    keys: IntArray
    """(W,) packed cells."""
    moments: Moments
    """Of the centroids of the Skip-map's voxels in each voxel, weighted by their points."""
    normals: FloatArray
    """(W, 10) of the Skip-map's voxels in it: how many, the sums of their normals and, in columns 4
    to 9, of ``outer_products`` of these."""

    def places(self, points_m: FloatArray) -> FloatArray:
        """(..., 3) points of the scan in the level's voxels."""
        return (points_m - self.centre_m) / self.size_m

    @property
    def alignment(self) -> FloatArray:
        """(W, 6) mean of n n^T over the normals n, so summed up that its product with
        ``outer_products(axis)`` is the mean squared cosine between the axis and them."""
        return self.normals[:, 4:] / self.normals[:, :1] * _TWICE

    def coarser(self) -> Level:
        """The level of voxels twice as wide."""
        keys, merged = group_keys(halve(self.keys))
        moments = add_up(Moments(self.moments.sums * _IN_TWICE_THE_VOXEL), merged, len(keys))
        normals = add_up(Moments(self.normals), merged, len(keys)).sums
        return Level(2 * self.size_m, self.centre_m, keys, moments, normals)


def level_of(skipmap: SkipMap) -> Level:
    """The Skip-map's own voxels, as a level."""
    size_m, centre_m = skipmap.voxel_size_m, skipmap.centroids_m.mean(axis=0)
    centroids = moments_of_points((skipmap.centroids_m - centre_m) / size_m)
    moments = Moments(centroids.sums * skipmap.counts[:, None])
    normals = moments_of_points(skipmap.normals).sums
    return Level(size_m, centre_m, skipmap.keys, moments, normals)


def outer_products(vectors: FloatArray) -> FloatArray:
    """(K, 6) entries xx, xy, xz, yy, yz, zz of v v^T."""
    return vectors[:, _ROW] * vectors[:, _COLUMN]


def tangent_frames(skipmap: SkipMap, rows: IntArray, around: Level | None = None) -> FloatArray:
    """Right-handed frames of the surface around voxels.

    Args:
        skipmap: the scan's Skip-map. Where the viewpoint is known the axes point to the sensor's
            side, as the normals around do; else to the side of the voxel's own, arbitrary normal.
        rows: (K,) voxels.
        around: ``level_of(skipmap).coarser()``, where it is at hand.

    Returns:
        (K, 3, 3) in columns: the surface's axis and two tangents of arbitrary azimuth.
    """
    if len(rows) == 0:
        return np.zeros((0, 3, 3))
    around = around or level_of(skipmap).coarser()
    middle = around.places(skipmap.centroids_m[rows])
    order, first, last = runs_around(middle, around.moments.mean, FRAME_REACH_VOXELS)
    figures = np.concatenate([around.moments.sums, around.normals[:, 1:4]], axis=1)
    sums = _weigh(middle, around.moments.mean[order], figures[order], first, last)
    _, axes = principal_axes(Moments(sums[:, :10]))
    known = skipmap.viewpoint_m is not None
    sides = sums[:, 10:] if known else skipmap.normals[rows]
    axis, tangent = axes[:, :, 0], axes[:, :, 2]
    axis = np.where(np.einsum("ki,ki->k", axis, sides)[:, None] < 0, -axis, axis)
    return np.stack([axis, tangent, np.cross(axis, tangent)], axis=2)


def runs_around(
    middle: FloatArray, around: FloatArray, reach: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Sort (W, 3) places so that what lies around each of (K, 3) others is in three runs.

    Args:
        middle: places to look around.
        around: what may lie around them.
        reach: how far around.

    Returns:
        (W,) order of what lies around, by slabs across x that are as thick as the reach, in each by
        y; (K, 3) where in this order the runs of each place start, and where they end. What a run
        has may still be too far away.
    """
    slab = np.floor(around[:, 0] / reach)
    key = slab * _FAR + around[:, 1]
    order = np.argsort(key, kind="stable")
    own_slab = np.floor(middle[:, 0] / reach)[:, None] + [-1, 0, 1]
    own_key = own_slab * _FAR + middle[:, 1:2]
    first, last = (np.searchsorted(key[order], end) for end in (own_key - reach, own_key + reach))
    return order, first, last


@compiled
def _weigh(
    middle: FloatArray, around: FloatArray, figures: FloatArray, first: IntArray, last: IntArray
) -> FloatArray:
    """(K, F) sums of (W, F) figures of what is near (K, 3) places; what is farther tells less.

    Args:
        middle: the places.
        around: (W, 3) in the order of ``runs_around``.
        figures: likewise.
        first: (K, 3) of ``runs_around``.
        last: likewise.
    """
    sums = np.zeros((len(middle), figures.shape[1]))
    for k in range(len(middle)):
        for run in range(3):
            for w in range(first[k, run], last[k, run]):
                x, y = around[w, 0] - middle[k, 0], around[w, 1] - middle[k, 1]
                z = around[w, 2] - middle[k, 2]
                weight = 1 - (x * x + y * y + z * z) / (FRAME_REACH_VOXELS * FRAME_REACH_VOXELS)
                if weight > 0:
                    for figure in range(figures.shape[1]):
                        sums[k, figure] += weight * figures[w, figure]
    return sums
