"""Scans of a few lines: GICP finds what voxels cannot, and says how firmly it holds."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, make_transform, pose_error, rotation_from_vector
from skipnet.registration.alignment.distributions import match_distributions
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.alignment.sparse import finish_sparse, refine_sparse
from skipnet.scans.describing import describe
from skipnet.scans.sparse import thin
from skipnet.simulation.scanning.pairs import simulate_pair

SIZE_M = 0.12


def started_from(T_target_source):
    count = len(T_target_source)
    return Refinement(
        T_target_source,
        np.zeros((count, 6, 6)),
        np.zeros(count, dtype=np.int64),
        np.zeros((count, 3)),
        np.zeros(count),
    )


@pytest.fixture(scope="module", params=[("paper_room", 3), ("oblique", 4)])
def rings(request):
    return simulate_pair(*request.param, scanner="rings").pair


@pytest.fixture(scope="module")
def clouds(rings):
    return thin(rings.source_m, SIZE_M), thin(rings.target_m, SIZE_M)


def test_ring_scans_are_told_from_dense_ones(rings):
    dense = simulate_pair("paper_room", 3, points=60_000).pair
    sparse, full = (
        [scan.is_sparse for scan in describe((p.source_m, p.target_m), ("auto", "auto"))]
        for p in (rings, dense)
    )
    assert any(sparse) and not any(full)


def test_it_converges_to_the_truth_from_5_cm_and_half_a_degree(rings, clouds):
    rng = np.random.default_rng(0)
    starts = np.stack(
        [
            make_transform(rotation_from_vector(rng.normal(scale=0.005, size=3)), way_m)
            @ rings.T_target_source
            for way_m in rng.normal(scale=0.03, size=(4, 3))
        ]
    )
    fine = refine_sparse(started_from(starts), *clouds, SIZE_M)
    for T in fine.T_target_source:
        rotation_rad, translation_m = pose_error(T, rings.T_target_source)
        assert np.rad2deg(rotation_rad) < 0.1 and translation_m < 0.02
    assert (fine.matched > 1000).all()


def test_what_is_not_worth_more_is_aligned_by_the_farthest_correspondences_alone(rings, clouds):
    rough = make_transform(rotation_from_vector(np.full(3, 0.01)), np.full(3, 0.1))
    start, asked = started_from((rough @ rings.T_target_source)[None]), []
    half = refine_sparse(start, *clouds, SIZE_M, lambda T: bool(asked.append(T)))
    whole = refine_sparse(start, *clouds, SIZE_M, lambda T: True)
    before, between, after = (
        pose_error(one.T_target_source[0], rings.T_target_source)[1] for one in (start, half, whole)
    )
    np.testing.assert_array_equal(asked, [half.T_target_source])
    assert after != between and max(after, between) < 0.1 * before


def test_the_best_one_is_aligned_by_all_points(rings, clouds):
    rough = make_transform(rotation_from_vector(np.full(3, 0.001)), np.full(3, 0.01))
    start = started_from((rough @ rings.T_target_source)[None])
    fine = finish_sparse(start, *clouds, SIZE_M)
    rotation_rad, translation_m = pose_error(fine.T_target_source[0], rings.T_target_source)
    assert np.rad2deg(rotation_rad) < 0.1 and translation_m < 0.02
    from_centre_m = np.linalg.norm(clouds[0].points_m - clouds[0].points_m.mean(axis=0), axis=1)
    np.testing.assert_allclose(fine.spread_m, np.sqrt((from_centre_m**2).mean()))


def test_one_step_has_the_normal_equations_of_small_gicp(rings, clouds):
    """Of all points, at the same pose: its H is about the source's origin, in the source's axes."""
    from small_gicp import align

    source, target = clouds
    theirs = align(
        target.cloud,
        source.cloud,
        target.tree,
        rings.T_target_source,
        max_correspondence_distance=SIZE_M,
        max_iterations=1,
        translation_epsilon=1e9,
        rotation_epsilon=1e9,
    )
    T = rings.T_target_source
    ours, squared = match_distributions(
        T[None], source, np.arange(len(source.points_m)), target, SIZE_M
    )
    R = T[:3, :3]
    # Their small motion (w, v) behind the pose turns by R w and moves our centre so far:
    centre_source_m = R.T @ (ours.centre_m[0] - T[:3, 3])
    change = np.zeros((6, 6))
    change[:3, :3], change[3:, 3:] = R, R
    change[3:, :3] = R @ np.cross(np.eye(3), -centre_source_m)  # w x centre
    expected = change.T @ ours.information[0] @ change
    assert ours.matched[0] == theirs.num_inliers
    np.testing.assert_allclose(theirs.H, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())
    # Theirs is what is left after the step, which at the true pose is next to nothing less.
    assert squared[0] * ours.matched[0] / 2 == pytest.approx(theirs.error, rel=0.01)


def test_the_stated_rotation_covariance_covers_the_error(rings, clouds):
    from scipy.spatial.transform import Rotation

    fine = finish_sparse(started_from(rings.T_target_source[None]), *clouds, SIZE_M)
    turned = fine.T_target_source[0] @ invert(rings.T_target_source)
    error_rad = Rotation.from_matrix(turned[:3, :3]).as_rotvec()
    squared = error_rad @ np.linalg.solve(fine.covariance[0][:3, :3], error_rad) / 3
    assert 0.01 < squared < 6


def test_a_pose_far_from_every_surface_stays_where_it_was(rings, clouds):
    far = make_transform(np.eye(3), np.array([500.0, 0, 0]))[None]
    for align in (refine_sparse, finish_sparse):
        fine = align(started_from(far), *clouds, SIZE_M)
        np.testing.assert_array_equal(fine.T_target_source, far)
        assert fine.matched[0] == 0


@pytest.mark.parametrize("reach_voxels", [4.0, 1.0])
def test_the_nearest_in_reach_are_those_of_scipy_wherever_one_asks(clouds, reach_voxels):
    from scipy.spatial import cKDTree

    _, target = clouds
    reach_m = reach_voxels * SIZE_M
    rng = np.random.default_rng(5)
    near_m = rng.choice(target.points_m, 800) + rng.normal(scale=reach_m, size=(800, 3))
    points_m = np.concatenate([near_m, rng.uniform(-1e4, 1e4, size=(200, 3))])
    away_m, rows = cKDTree(target.points_m).query(points_m)
    expected = np.where(away_m < reach_m, rows, -1)
    assert 0 < (expected < 0).sum() < 900
    np.testing.assert_array_equal(target.nearest(points_m, reach_m), expected)
    assert (target.nearest(np.full((3, 3), 1e4), reach_m) == -1).all()
