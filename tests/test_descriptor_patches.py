"""Cylindrical patches against a slow count by hand, and what must leave them alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.features.cylinders import (
    LEVELS,
    REACH_VOXELS,
    SECTOR_SIZE,
    SECTORS,
    choose_keypoints,
    cylinder_patches,
    turned_over,
)
from skipnet.geometry import random_rotation, rotation_from_vector
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.types import FloatArray


@pytest.fixture(scope="module")
def bumpy() -> SkipMap:
    """A wavy surface with a step, seen from above."""
    rng = np.random.default_rng(0)
    xy_m = rng.uniform(-2, 2, (20_000, 2))
    z_m = 0.3 * np.sin(3 * xy_m[:, 0]) + 0.5 * (xy_m[:, 1] > 0.5)
    return build_skipmap(np.column_stack([xy_m, z_m]), 0.1, np.array([0.0, 0.0, 5.0]))


def counts_by_hand(skipmap: SkipMap, row: int, around_m: FloatArray, size_m: float) -> FloatArray:
    """(5, 5, 5) points per sector, radius and height around one voxel, one point after another."""
    normal, first = skipmap.axes[row, :, 0], skipmap.axes[row, :, 2]
    second = np.cross(normal, first)
    counts = np.zeros((5, 5, 5))
    for point_m in around_m:
        offset = (point_m - skipmap.centroids_m[row]) / size_m
        if not 0 < np.linalg.norm(offset) <= REACH_VOXELS:
            continue
        height, x, y = offset @ normal, offset @ first, offset @ second
        cell = int(np.hypot(x, y)), int((height + 5) / 2)
        tenth = int(np.mod(np.arctan2(y, x), 2 * np.pi) / (2 * np.pi) * 10)
        own = tenth // 2
        neighbour = (own + (1 if tenth % 2 else -1)) % 5
        counts[own][cell] += 0.75
        counts[neighbour][cell] += 0.25
    return counts


@pytest.mark.parametrize("scale", range(len(LEVELS)))
def test_each_scale_is_the_count_by_hand(bumpy: SkipMap, scale: int) -> None:
    rows, step = choose_keypoints(bumpy, 40), 2 ** LEVELS[scale]
    groups: dict[tuple[int, ...], list[int]] = {}
    for row, cell in enumerate(bumpy.cells // step):
        groups.setdefault(tuple(cell), []).append(row)
    merged_m = np.array(
        [
            np.average(bumpy.centroids_m[group], axis=0, weights=bumpy.counts[group])
            for group in groups.values()
        ]
    )
    patches = cylinder_patches(bumpy, rows)
    assert patches.shape == (40, SECTORS, SECTOR_SIZE)
    size_m = step * bumpy.voxel_size_m
    expected = np.array([counts_by_hand(bumpy, row, merged_m, size_m) for row in rows])
    counted = np.expm1(patches.reshape(40, SECTORS, len(LEVELS), 5, 5)[:, :, scale])
    # Bins are looked up on a grid: a point near a border may be on its other side.
    np.testing.assert_allclose(counted.sum(), expected.sum(), rtol=1e-2)
    assert np.abs(counted - expected).sum() < 0.1 * expected.sum()


def test_a_turned_scan_has_the_same_patches(bumpy: SkipMap) -> None:
    rotation = random_rotation(np.random.default_rng(1))
    turned = replace(
        bumpy, centroids_m=bumpy.centroids_m @ rotation.T + 7.0, axes=rotation @ bumpy.axes
    )
    rows = choose_keypoints(bumpy, 300)
    same = np.isclose(cylinder_patches(bumpy, rows), cylinder_patches(turned, rows), atol=1e-4)
    assert same.mean() > 0.999


def test_the_unit_of_length_does_not_matter(bumpy: SkipMap) -> None:
    in_mm = replace(
        bumpy, voxel_size_m=bumpy.voxel_size_m * 1000, centroids_m=bumpy.centroids_m * 1000
    )
    rows = choose_keypoints(bumpy, 300)
    same = np.isclose(cylinder_patches(bumpy, rows), cylinder_patches(in_mm, rows), atol=1e-4)
    assert same.mean() > 0.999


def test_turning_the_tangent_by_a_sector_shifts_the_sectors(bumpy: SkipMap) -> None:
    rows = choose_keypoints(bumpy, 50)
    axes = bumpy.axes.copy()
    for row in rows:
        turn = rotation_from_vector(2 * np.pi / SECTORS * axes[row, :, 0])
        axes[row, :, 2] = turn @ axes[row, :, 2]
    before, after = (cylinder_patches(m, rows) for m in (bumpy, replace(bumpy, axes=axes)))
    shifted, left = np.abs(np.roll(before, -1, axis=1) - after), np.abs(before - after)
    assert shifted.sum() < 0.1 * after.sum() < 0.3 * left.sum()


def test_opposite_normals_turn_the_patches_over(bumpy: SkipMap) -> None:
    rows = choose_keypoints(bumpy, 50)
    axes = bumpy.axes.copy()
    axes[:, :, 0] *= -1
    expected = cylinder_patches(replace(bumpy, axes=axes), rows)
    patches = cylinder_patches(bumpy, rows)
    assert np.isclose(turned_over(patches), expected, atol=1e-4).mean() > 0.999
    assert not np.allclose(patches, expected)
    assert np.array_equal(turned_over(turned_over(patches)), patches)


def test_keypoints_are_the_most_curved(bumpy: SkipMap) -> None:
    rows = choose_keypoints(bumpy, 100)
    assert (np.diff(rows) > 0).all() and len(rows) == 100
    others = np.setdiff1d(np.arange(len(bumpy)), rows)
    assert bumpy.curvatures[rows].min() >= bumpy.curvatures[others].max()
    assert len(choose_keypoints(bumpy, 10**6)) == len(bumpy)


def test_no_voxels_no_patches(bumpy: SkipMap) -> None:
    none = np.zeros(0, dtype=np.int64)
    assert cylinder_patches(bumpy, none).shape == (0, SECTORS, SECTOR_SIZE)
