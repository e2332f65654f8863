"""Planes of a few arcs: found among walls, and how far above each other two scans' planes lie."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.alignment.thin_planes import find_thin_planes, heap_beside, lay_on_planes

SIZE_M, UP = 0.12, np.array([0.0, 0.0, 1.0])


def rings_in_a_room(seed, heights_m=(-1.5, 1.5), half_m=5.0, noise_m=0.001):
    """What 16 level scan lines see of a square room from its middle; floor and ceiling in arcs."""
    elevation = np.deg2rad(np.linspace(-15, 15, 16))[:, None]
    azimuth = np.linspace(0, 2 * np.pi, 900, endpoint=False)[None] + 0.01 * seed
    x, y = np.cos(azimuth), np.sin(azimuth)
    wall_m = half_m / np.maximum(np.abs(x), np.abs(y))
    slope = np.tan(elevation)
    level_m = np.where(slope < 0, heights_m[0], heights_m[1]) / slope
    flat_m = np.minimum(wall_m, np.abs(level_m))
    points_m = np.stack([flat_m * x, flat_m * y, flat_m * slope], axis=-1).reshape(-1, 3)
    return points_m + np.random.default_rng(seed).normal(scale=noise_m, size=points_m.shape)


def single(T):
    information = np.diag([1e6, 1e6, 1e6, 1e6, 1e6, 1e2])
    return Refinement(T[None], information[None], np.array([1000]), np.zeros((1, 3)), np.ones(1))


def test_floor_and_ceiling_are_found_and_nothing_else():
    planes = list(find_thin_planes(rings_in_a_room(0), UP, np.zeros(3), SIZE_M))
    assert sorted(round(plane.offset_m, 2) for plane in planes) == [-1.5, 1.5]
    for plane in planes:
        assert plane.normal @ UP > np.cos(np.deg2rad(0.05))
        assert 0.0005 < plane.scatter_m < 0.002


def test_scan_lines_on_walls_alone_are_no_planes():
    high = rings_in_a_room(0, heights_m=(-9.0, 9.0))
    assert list(find_thin_planes(high, UP, np.zeros(3), SIZE_M)) == []


@pytest.mark.parametrize("off_m", [0.06, -0.04])
def test_a_pose_is_corrected_across_the_planes_and_held_there(off_m):
    T = np.eye(4)
    T[2, 3] = off_m
    clouds = rings_in_a_room(1), rings_in_a_room(2)
    laid = lay_on_planes(single(T), *clouds, np.zeros(3), np.zeros(3), SIZE_M)
    assert abs(laid.T_target_source[0, 2, 3]) < 0.001
    np.testing.assert_allclose(laid.T_target_source[0, :2, 3], 0, atol=1e-4)
    assert laid.covariance[0, 5, 5] < 0.01 * single(T).covariance[0, 5, 5]


def test_nothing_changes_without_planes_or_viewpoints():
    before = single(np.eye(4))
    clouds = rings_in_a_room(1), rings_in_a_room(2)
    assert lay_on_planes(before, *clouds, None, np.zeros(3), SIZE_M) is before
    high = rings_in_a_room(1, (-9.0, 9.0)), rings_in_a_room(2, (-9.0, 9.0))
    assert lay_on_planes(before, *high, np.zeros(3), np.zeros(3), SIZE_M) is before


def test_planes_that_contradict_each_other_change_nothing():
    before, sensors_m = single(np.eye(4)), np.zeros((2, 3))
    raised = rings_in_a_room(2, heights_m=(-1.47, 1.53))
    laid = lay_on_planes(before, rings_in_a_room(1), raised, *sensors_m, SIZE_M)
    assert laid.T_target_source[0, 2, 3] == pytest.approx(0.03, abs=0.001)
    lower = rings_in_a_room(2, heights_m=(-1.47, 1.47))
    assert lay_on_planes(before, rings_in_a_room(1), lower, *sensors_m, SIZE_M) is before


def test_a_heap_stands_out_of_even_points_and_a_slope_has_none():
    rng = np.random.default_rng(0)
    plane = next(iter(find_thin_planes(rings_in_a_room(0), UP, np.zeros(3), SIZE_M)))
    even = rng.uniform(-5, 5, size=(4000, 3)) * [1, 1, 0.1] + plane.offset_m * UP
    assert heap_beside(even, plane, SIZE_M) is None
    heap = rng.uniform(-5, 5, size=(60, 3)) * [1, 1, 0] + (plane.offset_m + 0.03) * UP
    height_m, count = heap_beside(np.concatenate([even[:200], heap]), plane, SIZE_M)
    assert height_m == pytest.approx(0.03, abs=0.01) and count >= 50
