"""Cylindrical patches against a slow count by hand, and what must leave them alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.features import cylinders
from skipnet.features.cylinders import (
    KINDS,
    LEVELS,
    REACH_VOXELS,
    SECTOR_SIZE,
    SECTORS,
    choose_keypoints,
    cylinder_patches,
    turned_over,
)
from skipnet.features.frames import FRAME_REACH_VOXELS, tangent_frames
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


def merged(skipmap: SkipMap, step: int) -> list[list[int]]:
    """Rows of the voxels that share a cell ``step`` voxels wide, one group after another."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for row, cell in enumerate(skipmap.cells // step):
        groups.setdefault(tuple(cell), []).append(row)
    return list(groups.values())


def counts_by_hand(
    skipmap: SkipMap, row: int, frame: FloatArray, groups: list[list[int]], size_m: float
) -> FloatArray:
    """(5, 2, 5, 5) centroids per sector, kind, radius and height, one after another."""
    axis, first, second = frame.T
    counts = np.zeros((5, 2, 5, 5))
    for group in groups:
        point_m = np.average(skipmap.centroids_m[group], axis=0, weights=skipmap.counts[group])
        offset = (point_m - skipmap.centroids_m[row]) / size_m
        if not 0 < np.linalg.norm(offset) <= REACH_VOXELS:
            continue
        across = int(np.mean((skipmap.normals[group] @ axis) ** 2) < 0.5)
        height, x, y = offset @ axis, offset @ first, offset @ second
        cell = across, int(np.hypot(x, y)), int((height + 5) / 2)
        tenth = int(np.mod(np.arctan2(y, x), 2 * np.pi) / (2 * np.pi) * 10)
        own = tenth // 2
        neighbour = (own + (1 if tenth % 2 else -1)) % 5
        counts[(own, *cell)] += 0.75
        counts[(neighbour, *cell)] += 0.25
    return counts


def whole_turns(patches: FloatArray) -> FloatArray:
    """Counts of all sectors together: what no turn about the axis changes."""
    return np.expm1(patches).sum(axis=1)


def test_frames_are_the_principal_axes_of_what_is_near(bumpy: SkipMap) -> None:
    rows, groups = choose_keypoints(bumpy, 30), merged(bumpy, 2)
    size_m = 2 * bumpy.voxel_size_m
    middles_m = np.array(
        [np.average(bumpy.centroids_m[g], axis=0, weights=bumpy.counts[g]) for g in groups]
    )
    for row, frame in zip(rows, tangent_frames(bumpy, rows), strict=True):
        gap = np.linalg.norm(middles_m - bumpy.centroids_m[row], axis=1) / size_m
        near = [k for k in range(len(groups)) if gap[k] < FRAME_REACH_VOXELS]
        points_m = np.concatenate([bumpy.centroids_m[groups[k]] for k in near])
        weights = np.concatenate(
            [bumpy.counts[groups[k]] * (1 - (gap[k] / FRAME_REACH_VOXELS) ** 2) for k in near]
        )
        expected = np.linalg.eigh(np.cov(points_m.T, aweights=weights, ddof=0))[1]
        assert abs(expected[:, 0] @ frame[:, 0]) > 1 - 1e-6
        np.testing.assert_allclose(np.linalg.det(frame), 1, atol=1e-9)
        assert frame[2, 0] > 0 or abs(frame[2, 0]) < 0.3  # to the sensor, which is above


@pytest.mark.parametrize("scale", range(len(LEVELS)))
def test_each_scale_is_the_count_by_hand(bumpy: SkipMap, scale: int) -> None:
    rows, step = choose_keypoints(bumpy, 40), 2 ** LEVELS[scale]
    groups, size_m = merged(bumpy, step), step * bumpy.voxel_size_m
    patches = cylinder_patches(bumpy, rows)
    assert patches.shape == (40, SECTORS, SECTOR_SIZE)
    frames = tangent_frames(bumpy, rows)
    expected = np.array(
        [
            counts_by_hand(bumpy, row, frame, groups, size_m)
            for row, frame in zip(rows, frames, strict=True)
        ]
    )
    counted = np.expm1(patches.reshape(40, SECTORS, len(LEVELS), KINDS, 5, 5)[:, :, scale])
    # Bins are looked up on a grid: a point near a border may be on its other side.
    np.testing.assert_allclose(counted.sum(), expected.sum(), rtol=1e-2)
    assert np.abs(counted - expected).sum() < 0.1 * expected.sum()


def test_a_turned_scan_has_the_same_patches(bumpy: SkipMap) -> None:
    rotation = random_rotation(np.random.default_rng(1))
    turned = replace(
        bumpy,
        centroids_m=bumpy.centroids_m @ rotation.T + 7.0,
        normals=bumpy.normals @ rotation.T,
    )
    rows = choose_keypoints(bumpy, 300)
    before, after = (whole_turns(cylinder_patches(m, rows)) for m in (bumpy, turned))
    assert np.isclose(before, after, atol=1e-3).mean() > 0.98


def test_the_unit_of_length_does_not_matter(bumpy: SkipMap) -> None:
    in_mm = replace(
        bumpy, voxel_size_m=bumpy.voxel_size_m * 1000, centroids_m=bumpy.centroids_m * 1000
    )
    rows = choose_keypoints(bumpy, 300)
    same = np.isclose(cylinder_patches(bumpy, rows), cylinder_patches(in_mm, rows), atol=1e-4)
    assert same.mean() > 0.999


def test_turning_the_tangent_by_a_sector_shifts_the_sectors(
    bumpy: SkipMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = choose_keypoints(bumpy, 50)
    before = cylinder_patches(bumpy, rows)
    turn = rotation_from_vector(np.array([2 * np.pi / SECTORS, 0.0, 0.0]))
    frames = tangent_frames(bumpy, rows) @ turn
    monkeypatch.setattr(cylinders, "tangent_frames", lambda *_: frames)
    after = cylinder_patches(bumpy, rows)
    shifted, left = np.abs(np.roll(before, -1, axis=1) - after), np.abs(before - after)
    assert shifted.sum() < 0.1 * after.sum() < 0.3 * left.sum()


def test_opposite_normals_turn_the_patches_over(bumpy: SkipMap) -> None:
    rows = choose_keypoints(bumpy, 50)
    expected = cylinder_patches(replace(bumpy, normals=-bumpy.normals), rows)
    patches = cylinder_patches(bumpy, rows)
    assert np.isclose(turned_over(patches), expected, atol=1e-4).mean() > 0.99
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
    assert tangent_frames(bumpy, none).shape == (0, 3, 3)


def test_keypoints_that_are_not_the_most_curved_are_spread_over_the_rest(bumpy: SkipMap) -> None:
    order = np.argsort(-bumpy.curvatures, kind="stable")
    rows = choose_keypoints(bumpy, 40, curved_share=0.5)
    assert len(np.unique(rows)) == 40 and set(order[:20]) <= set(rows)
    ranks = np.sort(np.argsort(order)[rows])[20:]
    assert ranks[0] == 20 and ranks[-1] == len(bumpy) - 1
    assert np.ptp(np.diff(ranks)) <= 1
    np.testing.assert_array_equal(choose_keypoints(bumpy, len(bumpy), 0.5), np.arange(len(bumpy)))
