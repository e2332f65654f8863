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

from skipnet.geometry import invert, transform_points
from skipnet.simulation.scanning.scanner import Scanner
from skipnet.simulation.scenes.scenes import Scene
from skipnet.types import BoolArray, FeatureClass, FloatArray, IntArray

MAX_SURFACES = 8
"""Surfaces told apart around one position; further, smaller ones change no class."""


@dataclass(frozen=True)
class VisibleSurface:
    """Samples of all that a sensor can see of a scene, in the sensor's frame."""

    points_m: FloatArray
    """(S, 3) positions."""
    normals: FloatArray
    """(S, 3) unit normals, on the sensor's side."""
    surfaces: IntArray
    """(S,) id of the surface each sample belongs to."""
    areas_m2: FloatArray
    """(S,) area each sample stands for."""
    beams: FloatArray
    """(S,) beams of the scanner that meet that area, on average."""


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


def sample_scene(
    scene: Scene, spacing_m: float
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Cover every triangle evenly with samples, about one per ``spacing_m`` squared.

    Each triangle gets its own stretch of the R2 low-discrepancy sequence (Roberts 2018), so that
    the area seen through a small ball is met far better than by random points.

    Returns:
        (S, 3) points and (S, 3) unit normals in the world frame, (S,) triangle rows, (S,) areas.
    """
    a, b, c = (scene.vertices_m[scene.triangles[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    area_m2 = np.linalg.norm(normal, axis=1) / 2
    count = np.ceil(area_m2 / spacing_m**2).astype(np.int64)
    triangle = np.repeat(np.arange(len(count)), count)
    rank = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    plastic = 1.32471795724474602596
    u, v = (np.mod(0.5 + rank / plastic, 1.0), np.mod(0.5 + rank / plastic**2, 1.0))
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    points_m = a[triangle] + u[:, None] * (b - a)[triangle] + v[:, None] * (c - a)[triangle]
    unit = normal / np.maximum(2 * area_m2, 1e-30)[:, None]
    return points_m, unit[triangle], triangle, (area_m2 / np.maximum(count, 1))[triangle]


def visible_surface(
    scene: Scene, scanner: Scanner, T_world_sensor: FloatArray, spacing_m: float
) -> VisibleSurface:
    """All that a scanner at ``T_world_sensor`` can see of ``scene``.

    Args:
        scene: what stands there.
        scanner: its field of view, range and beam density.
        T_world_sensor: (4, 4) its pose.
        spacing_m: distance between samples; a third of a voxel is fine enough.
    """
    points_m, normals, triangle, areas_m2 = sample_scene(scene, spacing_m)
    ray_m = points_m - T_world_sensor[:3, 3]
    range_m = np.linalg.norm(ray_m, axis=1)
    facing = -np.einsum("si,si->s", normals, ray_m) / range_m
    direction = (ray_m / range_m[:, None]) @ T_world_sensor[:3, :3]
    beams = areas_m2 * np.abs(facing) / range_m**2 * beam_density(scanner, direction)
    seen = (beams > 0) & (range_m >= scanner.min_range_m) & (range_m <= scanner.max_range_m)
    seen[seen] = _unoccluded(scene, T_world_sensor[:3, 3], points_m[seen])
    T_sensor_world = invert(T_world_sensor)
    towards = normals[seen] * np.sign(facing[seen])[:, None]
    return VisibleSurface(
        transform_points(T_sensor_world, points_m[seen]),
        towards @ T_sensor_world[:3, :3].T,
        scene.surface_of_triangle[triangle[seen]].astype(np.int64),
        areas_m2[seen],
        beams[seen],
    )


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


def beam_density(scanner: Scanner, directions: FloatArray) -> FloatArray:
    """Beams per steradian of a scanner's regular grid of elevations and azimuths.

    Args:
        scanner: the model.
        directions: (S, 3) unit vectors in the frame in which the scanner sweeps about z.

    Returns:
        (S,) density, 0 outside the field of view. The grid crowds towards the poles.
    """
    elevation_rad = np.arcsin(np.clip(directions[:, 2], -1, 1))
    span_rad = scanner.highest_rad - scanner.lowest_rad
    per_rad2 = scanner.channels / span_rad * scanner.azimuth_steps / (2 * np.pi)
    inside = (elevation_rad >= scanner.lowest_rad) & (elevation_rad <= scanner.highest_rad)
    return np.where(inside, per_rad2 / np.maximum(np.cos(elevation_rad), 1e-2), 0.0)


def _unoccluded(scene: Scene, sensor_m: FloatArray, points_m: FloatArray) -> BoolArray:
    """(S,) bool: nothing stands between the sensor and the point."""
    hits = scene.raycaster.cast(sensor_m, points_m - sensor_m)
    # The ray's unit is the way to the point: 1 is the point itself, met up to rounding.
    return hits.distances >= 1 - 1e-3
