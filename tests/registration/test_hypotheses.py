"""Candidate poses from correspondences: against SciPy's alignment and planted truths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skipnet.geometry import make_transform, pose_error, random_rotation, transform_points
from skipnet.registration.hypotheses.correspondences import (
    Facing,
    common_neighbours,
    from_correspondences,
)
from skipnet.registration.hypotheses.fitting import best_rotations, fit_transforms
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses, concatenate


def random_motion(rng, scale_m=5.0):
    return make_transform(random_rotation(rng), rng.normal(scale=scale_m, size=3))


@pytest.mark.parametrize("count", [3, 64, 65, 300])
def test_common_neighbours_are_those_of_the_matrix_product(count):
    rng = np.random.default_rng(count)
    half = rng.random((count, count)) < 0.2
    compatible = half | half.T
    np.fill_diagonal(compatible, False)
    found = common_neighbours(compatible)
    product = compatible.astype(np.float32)
    np.testing.assert_array_equal(found, product * (product @ product))


def test_weighted_fits_are_scipys_align_vectors():
    rng = np.random.default_rng(0)
    source_m = rng.normal(size=(20, 9, 3))
    target_m = rng.normal(size=(20, 9, 3))  # nothing fits well: every term matters
    weights = rng.uniform(0.1, 2.0, size=(20, 9))
    for T, a, b, w in zip(
        fit_transforms(source_m, target_m, weights), source_m, target_m, weights, strict=True
    ):
        centre_a, centre_b = np.average(a, axis=0, weights=w), np.average(b, axis=0, weights=w)
        expected = Rotation.align_vectors(b - centre_b, a - centre_a, weights=w)[0].as_matrix()
        np.testing.assert_allclose(T[:3, :3], expected, atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], centre_b - expected @ centre_a, atol=1e-9)


def test_best_rotations_are_rotations_even_of_mirrored_sets():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(50, 3))
    mirrored = points * [1, 1, -1]
    rotation = best_rotations(mirrored.T @ points)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    expected = Rotation.align_vectors(mirrored, points)[0].as_matrix()
    np.testing.assert_allclose(rotation, expected, atol=1e-9)


@pytest.mark.parametrize("inlier_share", [1.0, 0.3, 0.1])
def test_the_planted_motion_is_found_among_false_correspondences(inlier_share):
    rng = np.random.default_rng(2)
    T_true = random_motion(rng)
    source_m = rng.uniform(-5, 5, size=(400, 3))
    target_m = transform_points(T_true, source_m) + rng.normal(scale=0.01, size=(400, 3))
    false = rng.random(400) >= inlier_share
    target_m[false] = rng.uniform(-5, 5, size=(false.sum(), 3))
    found = from_correspondences(source_m, target_m, np.ones(400), max_distance_m=0.05)
    rotation_rad, translation_m = pose_error(found.best(1).T_target_source[0], T_true)
    assert rotation_rad < 0.01 and translation_m < 0.03


def test_two_planted_motions_are_both_proposed():
    rng = np.random.default_rng(3)
    motions = [random_motion(rng), random_motion(rng)]
    source_m = rng.uniform(-5, 5, size=(200, 3))
    halves = [transform_points(T, source_m[i::2]) for i, T in enumerate(motions)]
    target_m = np.empty_like(source_m)
    target_m[0::2], target_m[1::2] = halves
    found = from_correspondences(source_m, target_m, np.ones(200), max_distance_m=0.05)
    for T_true in motions:
        errors_m = np.linalg.norm(found.T_target_source - T_true, axis=(1, 2))
        assert errors_m.min() < 1e-6


def test_weights_choose_between_equally_large_sets():
    rng = np.random.default_rng(4)
    motions = [random_motion(rng), random_motion(rng)]
    source_m = rng.uniform(-5, 5, size=(120, 3))
    target_m = np.concatenate(
        [transform_points(motions[0], source_m[:60]), transform_points(motions[1], source_m[60:])]
    )
    for trusted in (0, 1):
        weights = np.where(np.arange(120) // 60 == trusted, 1.0, 0.1)
        found = from_correspondences(source_m, target_m, weights, 0.01, seeds=20)
        errors_m = np.linalg.norm(found.T_target_source - motions[trusted], axis=(1, 2))
        assert errors_m.max() < 1e-6


def planted(sides_known):
    """Of 600 correspondences 7 are right; normals are shaken, of either sign if not known."""
    rng = np.random.default_rng(6)
    T_true = random_motion(rng)
    source_m, target_m = rng.uniform(-5, 5, size=(2, 600, 3))
    axes_s, axes_t = rng.normal(size=(2, 600, 3))
    target_m[:7] = transform_points(T_true, source_m[:7])
    axes_t[:7] = axes_s[:7] @ T_true[:3, :3].T
    axes_s, axes_t = (axes / np.linalg.norm(axes, axis=1)[:, None] for axes in (axes_s, axes_t))
    axes_t = axes_t + rng.normal(scale=0.02, size=axes_t.shape)
    signs = np.ones(600) if sides_known else rng.choice([-1.0, 1.0], 600)
    axes_t *= (signs / np.linalg.norm(axes_t, axis=1))[:, None]
    return T_true, source_m, target_m, axes_s, axes_t


@pytest.mark.parametrize("sides_known", [True, False])
def test_angles_between_surfaces_tell_the_few_right_correspondences(sides_known):
    T_true, source_m, target_m, *axes = planted(sides_known)
    facing = Facing(*axes, sides_known)
    ways = (source_m, target_m, np.ones(600), 0.3)
    found = from_correspondences(*ways, facing=facing, support=5)
    rotation_rad, translation_m = pose_error(found.best(1).T_target_source[0], T_true)
    assert rotation_rad < 1e-6 and translation_m < 1e-6
    without = from_correspondences(*ways, support=5)
    assert pose_error(without.best(1).T_target_source[0], T_true)[0] > 0.1
    turned = Facing(axes[0], -axes[1][:, [1, 2, 0]], sides_known)
    others = from_correspondences(*ways, facing=turned, support=5)
    assert all(pose_error(T, T_true)[0] > 0.1 for T in others.T_target_source)


def test_angles_go_by_hand_and_short_lines_say_nothing():
    square_m = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
    up = np.tile([0.0, 0, 1], (4, 1))
    tipped = up.copy()
    tipped[3] = [0.0, 0.6, 0.8]  # its angle to the line from the first one differs by 0.6
    ways = (square_m, square_m, np.ones(4), 0.1)
    for axes, proposed in ((up, 4), (tipped, 3)):
        found = from_correspondences(*ways, facing=Facing(up, axes, True))
        assert len(found) == proposed
    near = (0.01 * square_m, 0.01 * square_m, np.ones(4), 0.1)
    barely = up.copy()
    barely[3] = [0.0, 0.53, 0.848]  # 0.15 to its neighbours' axes, 0.53 to a line too short to say
    assert len(from_correspondences(*near, facing=Facing(up, barely, True))) == 4


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_correspondences_propose_nothing(count):
    points_m = np.eye(3)[:count]
    assert len(from_correspondences(points_m, points_m, np.ones(count), 0.1)) == 0


def test_correspondences_that_agree_with_nothing_propose_nothing():
    rng = np.random.default_rng(5)
    source_m, target_m = rng.normal(size=(2, 6, 3)) * [[[1.0]], [[100.0]]]
    assert len(from_correspondences(source_m, target_m, np.ones(6), 1e-3)) == 0


def test_stacks_join_in_order_and_the_best_are_the_heaviest():
    first = Hypotheses(np.stack([np.eye(4)] * 3), np.array([1.0, 5.0, 3.0]))
    second = Hypotheses(2 * np.eye(4)[None], np.array([4.0]))
    joined = concatenate([first, NO_HYPOTHESES, second])
    np.testing.assert_array_equal(joined.weights, [1, 5, 3, 4])
    np.testing.assert_array_equal(joined.best(3).weights, [5, 4, 3])
    np.testing.assert_array_equal(joined.best(3).T_target_source[1], 2 * np.eye(4))
    assert len(concatenate([])) == 0
