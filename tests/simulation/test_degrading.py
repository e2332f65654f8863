"""How scans get worse: each step does what it says, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, rotation_from_vector, transform_points
from skipnet.simulation.scanning.degrading import (
    add_passers_by,
    blur_depth,
    cut,
    degrade,
    fuse,
    shake,
    tear_holes,
    thin,
)
from skipnet.simulation.scanning.recipe import Recipe

POINTS_M = np.random.default_rng(0).uniform(-3, 3, (20_000, 3))


def rows(points_m):
    return {tuple(point) for point in points_m}


def test_passers_by_stop_beams_on_their_way():
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points_m = 5 * directions
    moved_m = add_passers_by(points_m, 3, np.random.default_rng(2))
    ranges_m = np.linalg.norm(moved_m, axis=1)
    np.testing.assert_allclose(moved_m / ranges_m[:, None], directions, atol=1e-9)
    stopped = ranges_m < 4.9
    assert 0 < stopped.sum() < 1000
    assert ranges_m[stopped].min() > 1.4 and ranges_m[stopped].max() < 4.1
    np.testing.assert_array_equal(moved_m[~stopped], points_m[~stopped])
    np.testing.assert_array_equal(add_passers_by(points_m, 0, rng), points_m)


def test_a_cut_leaves_out_the_smallest_share():
    left_m = cut(POINTS_M, POINTS_M[:, 0], 0.3)
    assert len(left_m) == pytest.approx(14_000, abs=2)
    assert left_m[:, 0].min() > np.sort(POINTS_M[:, 0])[5_990]


@pytest.mark.parametrize(("least", "most"), [(0.25, 0.25), (0.2, 0.9)])
def test_thinning_keeps_a_share_of_the_points_as_they_are(least, most):
    kept_m = thin(POINTS_M, least, most, np.random.default_rng(1))
    assert least - 0.02 < len(kept_m) / len(POINTS_M) < most + 0.02
    assert rows(kept_m) <= rows(POINTS_M)


def test_noise_has_its_deviation_and_none_changes_nothing():
    moved_m = shake(POINTS_M, 0.02, np.random.default_rng(2)) - POINTS_M
    assert moved_m.std() == pytest.approx(0.02, rel=0.02) and abs(moved_m.mean()) < 1e-3
    np.testing.assert_array_equal(shake(POINTS_M, 0.0, np.random.default_rng(2)), POINTS_M)


def test_depth_noise_stays_on_the_beam_and_grows_with_the_range_s_square():
    ways = np.random.default_rng(3).normal(size=(20_000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    for range_m in (1.0, 4.0):
        points_m = (range_m * ways).astype(np.float32)
        blurred_m = blur_depth(points_m, 0.002, np.random.default_rng(4))
        assert blurred_m.dtype == np.float32
        ranges_m = np.linalg.norm(blurred_m, axis=1)
        np.testing.assert_allclose(blurred_m / ranges_m[:, None], ways, atol=1e-5)
        assert (ranges_m - range_m).std() == pytest.approx(0.002 * range_m**2, rel=0.03)


def test_holes_are_balls_of_two_to_twelve_voxels():
    assert len(tear_holes(POINTS_M, 0, 0.1, np.random.default_rng(5))) == len(POINTS_M)
    left_m = tear_holes(POINTS_M, 1, 0.1, np.random.default_rng(5))
    torn_m = np.array([*(rows(POINTS_M) - rows(left_m))])
    middle_m = torn_m.mean(axis=0)
    radius_m = np.linalg.norm(torn_m - middle_m, axis=1).max()
    assert 0.15 < radius_m < 1.3
    assert (np.linalg.norm(left_m - middle_m, axis=1) > 0.8 * radius_m).all()


def test_fused_clouds_lie_in_the_frame_of_the_first():
    poses = [
        make_transform(rotation_from_vector(np.array(turn)), np.array(shift_m))
        for turn, shift_m in (([0.1, 0.2, 0.3], [1.0, 2, 3]), ([0, -1.0, 0.5], [-2.0, 0, 1]))
    ]
    parts_m = [transform_points(np.linalg.inv(T), POINTS_M[:100]) for T in poses]
    fused_m = fuse(parts_m, poses)
    np.testing.assert_array_equal(fused_m[:100], parts_m[0])
    np.testing.assert_allclose(fused_m[100:], parts_m[0], atol=1e-9)


def test_a_recipe_that_does_nothing_leaves_the_scan_as_it_is():
    still = Recipe(least_kept=1.0, holes=0)
    np.testing.assert_array_equal(
        degrade(POINTS_M, 0.1, 0.0, still, np.random.default_rng(6)), POINTS_M
    )
    torn_m = degrade(POINTS_M, 0.1, 0.0, Recipe(), np.random.default_rng(6))
    assert rows(torn_m) < rows(POINTS_M)
