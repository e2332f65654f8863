"""Errors and rates: hand-worked cases first, SciPy and invariants, then bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from skipnet.benchmark.datasets.pairset import move_source
from skipnet.benchmark.options import ProtocolKind
from skipnet.benchmark.scoring.protocols import PROTOCOLS, right_by_rule
from skipnet.geometry import make_transform, rotation_from_vector, transform_points
from skipnet.metrics.poses import (
    MISSING_POSE,
    axis_errors_m,
    inlier_ratio,
    rmse_m,
    score_pose,
    success_rate,
    wilson_interval,
)
from skipnet.types import Pair

POINTS_M = np.array([[1.0, 0.0, 5.0], [2.0, 0.5, 5.0], [-3.0, 1.0, 0.0]])


def pair_with(T_target_source, rotation_deg=0.5, translation_m=0.03):
    return Pair(
        name="pair",
        set_name="set",
        source_m=POINTS_M,
        target_m=POINTS_M,
        T_target_source=T_target_source,
        success_rotation_rad=np.deg2rad(rotation_deg),
        success_translation_m=translation_m,
    )


def test_shift_moves_every_point_alike():
    T_shifted = make_transform(np.eye(3), np.array([0.01, -0.02, 0.0]))
    assert axis_errors_m(T_shifted, np.eye(4), POINTS_M) == pytest.approx((0.01, 0.02, 0.0))


def test_quarter_turn_by_hand():
    # (x, y) -> (-y, x): displacements (-y - x, x - y), here (-1, 1), (-2.5, 1.5), (2, -4).
    T_turned = make_transform(rotation_from_vector(np.array([0, 0, np.pi / 2])), np.zeros(3))
    expected = (1 + 2.5 + 2) / 3, (1 + 1.5 + 4) / 3, 0.0
    assert axis_errors_m(T_turned, np.eye(4), POINTS_M) == pytest.approx(expected)


def test_axis_errors_do_not_depend_on_the_source_frame():
    rng = np.random.default_rng(0)
    T_estimated, T_true, T_source_other = (
        make_transform(Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3))
        for _ in range(3)
    )
    other_m = transform_points(np.linalg.inv(T_source_other), POINTS_M)
    moved = axis_errors_m(T_estimated @ T_source_other, T_true @ T_source_other, other_m)
    assert moved == pytest.approx(axis_errors_m(T_estimated, T_true, POINTS_M))


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "success"),
    [(0.49, 0.029, True), (0.51, 0.0, False), (0.0, 0.031, False), (180.0, 0.0, False)],
)
def test_success_needs_both_errors_under_their_thresholds(turn_deg, shift_m, success):
    rng = np.random.default_rng(1)
    truth = make_transform(Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3))
    axis, direction = rng.standard_normal((2, 3))
    turn = Rotation.from_rotvec(np.deg2rad(turn_deg) * axis / np.linalg.norm(axis)).as_matrix()
    shift = shift_m * direction / np.linalg.norm(direction)
    estimate = make_transform(turn @ truth[:3, :3], truth[:3, 3] + shift)
    score = score_pose(estimate, pair_with(truth))
    assert score.success is success
    assert np.rad2deg(score.rotation_error_rad) == pytest.approx(turn_deg, abs=1e-5)
    assert score.translation_error_m == pytest.approx(shift_m, abs=1e-12)


def test_mean_error_is_the_mean_of_the_axes():
    score = score_pose(make_transform(np.eye(3), np.array([0.03, 0.0, 0.06])), pair_with(np.eye(4)))
    assert score.mean_error_m == pytest.approx(0.03)


@pytest.mark.parametrize("estimate", [None, np.full((4, 4), np.nan)])
def test_no_pose_is_a_failure_with_infinite_errors(estimate):
    score = score_pose(estimate, pair_with(np.eye(4)))
    assert score == MISSING_POSE
    assert not score.success
    assert score.mean_error_m == np.inf


def test_failures_stay_in_the_denominator():
    assert success_rate([True, False, False, True]) == 0.5


@pytest.mark.parametrize(("successes", "pairs"), [(0, 7), (3, 7), (81, 88), (40, 40)])
def test_wilson_interval_agrees_with_scipy(successes, pairs):
    expected = binomtest(successes, pairs).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, pairs) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize(
    "call",
    [
        lambda: axis_errors_m(np.eye(4), np.eye(4), np.zeros((0, 3))),
        lambda: success_rate([]),
        lambda: wilson_interval(0, 0),
        lambda: wilson_interval(5, 4),
    ],
)
def test_means_over_nothing_are_refused(call):
    with pytest.raises(ValueError, match="expected|need"):
        call()


# --- RMSE through gt.info -------------------------------------------------------------------------


def with_information(points_m, **options):
    """The pair of 3DMatch's gt.info: sum over points of J^T J, J = [I | -2 [p]x] of (t, q)."""
    information = np.zeros((6, 6))
    for x, y, z in points_m:
        cross = np.array([[0.0, -z, y], [z, 0, -x], [-y, x, 0]])
        jacobian = np.hstack([np.eye(3), -2 * cross])
        information += jacobian.T @ jacobian
    pair = replace(pair_with(np.eye(4)), information=information)
    return replace(pair, **options)


def test_rmse_of_a_shift_is_its_length():
    pair = with_information(POINTS_M)
    T_shifted = make_transform(np.eye(3), np.array([0.12, 0.16, 0.0]))
    assert rmse_m(T_shifted, pair) == pytest.approx(0.2)


def test_rmse_is_that_of_the_points_for_a_small_motion():
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-2, 2, (200, 3))
    truth = make_transform(Rotation.random(rng=rng).as_matrix(), rng.standard_normal(3))
    pair = with_information(points_m, T_target_source=truth)
    small = make_transform(
        rotation_from_vector(np.array([0.02, -0.01, 0.03])), np.array([0.05, 0, 0.02])
    )
    moved_m = transform_points(truth @ small, points_m) - transform_points(truth, points_m)
    expected = np.sqrt((moved_m**2).sum(axis=1).mean())
    assert rmse_m(truth @ small, pair) == pytest.approx(expected, rel=0.02)


def test_rmse_does_not_depend_on_how_the_source_was_turned():
    rng = np.random.default_rng(0)
    pair = with_information(rng.uniform(-2, 2, (50, 3)))
    small = make_transform(rotation_from_vector(np.array([0.1, 0.0, 0.2])), np.array([0.1, 0, 0]))
    turned = move_source(pair, seed=4, turn=True, shift_m=0.0)
    T_moved = turned.T_target_source @ np.linalg.inv(pair.T_target_source)
    estimate = pair.T_target_source @ small
    assert rmse_m(estimate @ T_moved, turned) == pytest.approx(rmse_m(estimate, pair))
    with pytest.raises(ValueError, match="shift_m=0"):
        move_source(pair, seed=4, turn=True, shift_m=1.0)


def test_rmse_needs_gt_info():
    with pytest.raises(ValueError, match="gt.info"):
        rmse_m(np.eye(4), pair_with(np.eye(4)))


# --- protocols ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "right"),
    [
        (1.9, 0.29, {"deg2_30cm", "deg5_60cm", "deg5_2m", "deg15_30cm"}),
        (2.1, 0.29, {"deg5_60cm", "deg5_2m", "deg15_30cm"}),
        (4.9, 0.59, {"deg5_60cm", "deg5_2m"}),
        (4.9, 1.99, {"deg5_2m"}),
        (4.9, 2.01, set()),
        (14.9, 0.29, {"deg15_30cm"}),
        (15.1, 0.0, set()),
        (0.4, 0.02, {"own", "deg2_30cm", "deg5_60cm", "deg5_2m", "deg15_30cm"}),
    ],
)
def test_each_rule_has_its_own_limits(turn_deg, shift_m, right):
    turn = rotation_from_vector(np.array([0, 0, np.deg2rad(turn_deg)]))
    pair = pair_with(np.eye(4))
    score = score_pose(make_transform(turn, np.array([shift_m, 0, 0])), pair)
    assert {name for name, flag in right_by_rule(score, pair).items() if flag} == right


@pytest.mark.parametrize(("shift_m", "right"), [(0.199, True), (0.201, False)])
def test_3dmatch_asks_for_an_rmse_below_20_cm_of_pairs_that_are_not_consecutive(shift_m, right):
    pair = with_information(POINTS_M)
    score = score_pose(make_transform(np.eye(3), np.array([shift_m, 0, 0])), pair)
    assert right_by_rule(score, pair)["rmse_20cm"] is right
    neighbours = replace(pair, consecutive=True)
    assert "rmse_20cm" not in right_by_rule(score, neighbours)
    assert "deg15_30cm" in right_by_rule(score, neighbours)
    assert "rmse_20cm" not in right_by_rule(score, replace(pair, information=None))


def test_no_pose_is_right_by_no_rule():
    assert not any(right_by_rule(MISSING_POSE, with_information(POINTS_M)).values())
    assert set(PROTOCOLS) == set(ProtocolKind)


def test_inlier_ratio_by_hand():
    target_m = POINTS_M + [[0.05, 0, 0], [0.2, 0, 0], [0, 0, 0]]
    assert inlier_ratio(POINTS_M, target_m, np.eye(4), 0.1) == pytest.approx(2 / 3)
    assert inlier_ratio(np.zeros((0, 3)), np.zeros((0, 3)), np.eye(4), 0.1) == 0.0
