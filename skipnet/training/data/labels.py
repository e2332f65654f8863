"""The true class of a feature voxel, from the scene's geometry and where the sensor stood.

The scan itself takes no part, except that it says at which positions a label is asked for. The
scene's surfaces are sampled densely, the samples that the sensor can see are kept, and around each
position the distinct surfaces among them are counted: one is a plane, two an edge, three or more a
corner, whose kind follows from how the surfaces lie to each other (``skipnet.types.FeatureClass``).

What counts as a surface at a position is the definition's other half:

- it lies within ``radius_m``, and the sensor sees at least ``min_area_m2`` of it there;
- the scanner sends at least ``min_beams`` there, so that the scan had a chance to show it;
- surfaces that continue each other (nearly one plane) count once; a smooth surface is one surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.training.data.visibility import VisibleSurface
from skipnet.types import BoolArray, FeatureClass, FloatArray, IntArray

MAX_SURFACES = 8
"""Surfaces told apart around one position; further, smaller ones change no class."""


@dataclass(frozen=True)
class LabelRule:
    """What counts as a surface; lengths in voxels, so that it scales with the patch."""

    radius_voxels: float = 2.5
    min_area_voxels2: float = 3.0
    """Visible area; a plane through the centre shows pi radius^2."""
    min_beams: float = 6.0
    merge_angle_rad: float = float(np.deg2rad(15.0))
    """Surfaces whose normals differ by less, and ..."""
    merge_offset_voxels: float = 0.5
    """... whose planes lie closer than this, are one."""


def label_positions(
    positions_m: FloatArray, visible: VisibleSurface, voxel_size_m: float, rule: LabelRule
) -> IntArray:
    """The true class at each position.

    Args:
        positions_m: (K, 3) in the sensor's frame.
        visible: from ``visible_surface``.
        voxel_size_m: the length that the rule's voxels stand for.
        rule: what counts as a surface.

    Returns:
        (K,) int64 ``FeatureClass`` values; -1 where the sensor sees no surface within the radius.
    """
    around = _surfaces_around(positions_m, visible, voxel_size_m, rule)
    return classify_surfaces(around.points_m, around.normals, around.present)


def classify_surfaces(points_m: FloatArray, normals: FloatArray, present: BoolArray) -> IntArray:
    """Class of (K, M) surfaces given by a point and a sensor-side normal each.

    Two surfaces are concave to each other when each one's point lies in front of the other
    surface, convex when each lies behind.

    Args:
        points_m: (K, M, 3) centre of the visible part of each surface.
        normals: (K, M, 3) unit normals.
        present: (K, M) bool, which of the M places are taken.

    Returns:
        (K,) int64 ``FeatureClass`` values; -1 where none is present.

    >>> floor_and_walls = np.array([[[1.0, 1, 0], [1, 0, 1], [0, 1, 1]]])
    >>> inwards = np.array([[[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]])
    >>> here = np.ones((1, 3), dtype=bool)
    >>> FeatureClass(classify_surfaces(floor_and_walls, inwards, here)[0]).name
    'FIRST_CORNER'
    >>> FeatureClass(classify_surfaces(floor_and_walls, -inwards, here)[0]).name
    'SECOND_CORNER'
    """
    count = present.sum(axis=1)
    # height[k, i, j]: how far surface j's point lies in front of surface i
    height = np.einsum("kic,kijc->kij", normals, points_m[:, None, :] - points_m[:, :, None])
    both = present[:, :, None] & present[:, None, :] & ~np.eye(points_m.shape[1], dtype=bool)
    concave = ((height > 0) | ~both).all(axis=(1, 2))
    convex = ((height < 0) | ~both).all(axis=(1, 2))
    corner = np.select(
        [concave, convex],
        [FeatureClass.FIRST_CORNER, FeatureClass.SECOND_CORNER],
        FeatureClass.OTHER_CORNER,
    )
    few = np.array([-1, FeatureClass.PLANE, FeatureClass.EDGE])
    return np.where(count < 3, few[np.minimum(count, 2)], corner).astype(np.int64)


@dataclass(frozen=True)
class _Around:
    """Distinct surfaces around K positions, the largest first."""

    points_m: FloatArray
    """(K, M, 3)"""
    normals: FloatArray
    """(K, M, 3)"""
    present: BoolArray
    """(K, M) bool"""


def _surfaces_around(
    positions_m: FloatArray, visible: VisibleSurface, voxel_size_m: float, rule: LabelRule
) -> _Around:
    position, sample = _pairs_within(
        positions_m, visible.points_m, rule.radius_voxels * voxel_size_m
    )
    surfaces = int(visible.surfaces.max(initial=0)) + 1
    place = position * surfaces + visible.surfaces[sample]
    taken = np.zeros(len(positions_m) * surfaces, dtype=bool)
    taken[place] = True
    group, row = np.flatnonzero(taken), (np.cumsum(taken) - 1)[place]  # np.unique would sort
    owner = group // surfaces

    def total(values: FloatArray) -> FloatArray:
        """(G,) sums of (P,) values over the pairs of each position and surface."""
        return np.bincount(row, weights=values, minlength=len(group)).astype(np.float64)

    weight = visible.areas_m2[sample]
    area_m2, beams = total(weight), total(visible.beams[sample])
    mean_m = np.stack([total(weight * visible.points_m[sample, k]) for k in range(3)], axis=1)
    mean_m /= area_m2[:, None]
    normal = np.stack([total(weight * visible.normals[sample, k]) for k in range(3)], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]
    counts = (area_m2 >= rule.min_area_voxels2 * voxel_size_m**2) & (beams >= rule.min_beams)
    # The largest surface always counts: something is there, the position came from it.
    order = np.lexsort((-area_m2, owner))
    first = np.ones(len(order), dtype=bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    order = order[counts[order] | first]
    return _merge(
        _pad(owner[order], mean_m[order], normal[order], len(positions_m)), voxel_size_m, rule
    )


def _pad(owner: IntArray, points_m: FloatArray, normals: FloatArray, positions: int) -> _Around:
    """Rows sorted by owner into (K, M) places."""
    start = np.searchsorted(owner, np.arange(positions))
    place = np.arange(len(owner)) - start[owner]
    kept = place < MAX_SURFACES
    padded = _Around(
        np.zeros((positions, MAX_SURFACES, 3)),
        np.zeros((positions, MAX_SURFACES, 3)),
        np.zeros((positions, MAX_SURFACES), dtype=bool),
    )
    at = owner[kept], place[kept]
    padded.points_m[at], padded.normals[at], padded.present[at] = (
        points_m[kept],
        normals[kept],
        True,
    )
    return padded


def _merge(around: _Around, voxel_size_m: float, rule: LabelRule) -> _Around:
    """Drop each surface that continues a larger one."""
    present = around.present.copy()
    offset_m = rule.merge_offset_voxels * voxel_size_m
    for small in range(1, MAX_SURFACES):
        for large in range(small):
            gap_m = around.points_m[:, small] - around.points_m[:, large]
            aligned = np.einsum("kc,kc->k", around.normals[:, small], around.normals[:, large])
            height_m = np.abs(np.einsum("kc,kc->k", around.normals[:, large], gap_m))
            same = (aligned > np.cos(rule.merge_angle_rad)) & (height_m < offset_m)
            present[:, small] &= ~(same & present[:, large])
    return _Around(around.points_m, around.normals, present)


def _pairs_within(
    positions_m: FloatArray, points_m: FloatArray, radius_m: float
) -> tuple[IntArray, IntArray]:
    """Rows (position, point) of all pairs closer than ``radius_m``."""
    from scipy.sparse import coo_array
    from scipy.spatial import cKDTree

    tree = cKDTree(points_m)
    near = cKDTree(positions_m).sparse_distance_matrix(tree, radius_m, output_type="coo_matrix")
    rank = np.empty(len(points_m), dtype=near.col.dtype)
    rank[tree.indices] = np.arange(len(points_m))
    near = coo_array((near.data, (near.row, rank[near.col])), near.shape)
    near = near.tocsc().tocsr()  # sorted by rows, then columns
    position = np.repeat(np.arange(len(positions_m)), np.diff(near.indptr))
    return position, tree.indices[near.indices]
