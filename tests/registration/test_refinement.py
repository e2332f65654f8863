"""Fine alignment: converges to the truth, against Open3D's ICP, and never across a thin wall."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import (
    invert,
    make_transform,
    pose_error,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.registration.alignment.normal_equations import Matches
from skipnet.registration.alignment.refinement import (
    DAMPING_VOXELS,
    Refinement,
    gauss_newton_step,
    refine,
)
from skipnet.registration.judging.sliding import holds, is_weak
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.skipmap import build_skipmap

SIZES_M = (0.4, 0.2, 0.1)
ORIGIN_M = np.zeros(3)


def levels_of(source_m, target_m, viewpoints=(ORIGIN_M, ORIGIN_M), sizes_m=SIZES_M):
    return [
        tuple(
            build_skipmap(p, size, v) for p, v in zip((source_m, target_m), viewpoints, strict=True)
        )
        for size in sizes_m
    ]


@pytest.fixture(scope="module", params=[("paper_room", 1), ("oblique", 4), ("curved", 2)])
def pair(request):
    return simulate_pair(*request.param, points=60_000).pair


@pytest.fixture(scope="module")
def clouds_m(pair):
    return pair.source_m.astype(float), pair.target_m.astype(float)


def disturbed(T, seed, angle_rad=0.0175, shift_m=0.03):
    rng = np.random.default_rng(seed)
    axis, way = rng.normal(size=(2, 3))
    rotation = rotation_from_vector(angle_rad * axis / np.linalg.norm(axis))
    return make_transform(rotation, shift_m * way / np.linalg.norm(way)) @ T


def test_it_converges_to_the_truth_from_3_cm_and_1_degree(pair, clouds_m):
    starts = np.stack([disturbed(pair.T_target_source, seed) for seed in range(6)])
    fine = refine(starts, levels_of(*clouds_m))
    for T in fine.T_target_source:
        rotation_rad, translation_m = pose_error(T, pair.T_target_source)
        assert np.rad2deg(rotation_rad) < 0.02 and translation_m < 0.0015
    # All starts end in one place, and it is not merely the one they came from.
    assert np.ptp(fine.T_target_source, axis=0).max() < 2e-4
    assert (fine.matched > 500).all()


def test_it_is_no_worse_than_open3ds_point_to_plane_icp(pair, clouds_m):
    import open3d as o3d

    source, target = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in clouds_m)
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.3, 30))
    start = disturbed(pair.T_target_source, 1)
    peer = o3d.pipelines.registration.registration_icp(
        source,
        target,
        0.1,
        start,
        o3d.pipelines.registration.TransformationEstimationPointToPlane(),
        o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=100),
    ).transformation
    ours = refine(start[None], levels_of(*clouds_m)).T_target_source[0]
    error_m = [displacement_m(T, pair.T_target_source, clouds_m[0]) for T in (ours, peer)]
    assert error_m[0] < 1.2 * error_m[1] + 2e-4


def test_two_rooms_seen_through_one_door_are_not_drawn_to_each_others_walls():
    pair = simulate_pair("doorway", 2, points=60_000).pair
    levels = levels_of(pair.source_m.astype(float), pair.target_m.astype(float))
    fine = refine(disturbed(pair.T_target_source, 0)[None], levels)
    rotation_rad, translation_m = pose_error(fine.T_target_source[0], pair.T_target_source)
    assert np.rad2deg(rotation_rad) < 0.1 and translation_m < 0.01


def displacement_m(T, T_true, points_m):
    """Largest distance between where two poses put a point."""
    apart_m = transform_points(T, points_m) - transform_points(T_true, points_m)
    return np.linalg.norm(apart_m, axis=1).max()


def test_candidates_do_not_influence_each_other(pair, clouds_m):
    starts = np.stack([disturbed(pair.T_target_source, seed, 0.03, 0.1) for seed in range(5)])
    levels = levels_of(*clouds_m)
    together = refine(starts, levels, samples=800, max_steps=4)
    for row, start in enumerate(starts):
        alone = refine(start[None], levels, samples=800, max_steps=4)
        np.testing.assert_allclose(
            together.T_target_source[row], alone.T_target_source[0], atol=1e-4
        )


def test_the_frames_of_the_clouds_do_not_matter_beyond_the_noise(pair, clouds_m):
    rng = np.random.default_rng(3)
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    start = disturbed(pair.T_target_source, 0)
    here = refine(start[None], levels_of(*clouds_m)).T_target_source[0]
    moved_m = transform_points(T, clouds_m[0])
    levels = levels_of(moved_m, clouds_m[1], (T[:3, 3], ORIGIN_M))
    there = refine((start @ invert(T))[None], levels).T_target_source[0] @ T
    assert displacement_m(there, here, clouds_m[0]) < 0.003


def wall(seed, x_m, count=20_000):
    return np.random.default_rng(seed).uniform([x_m, -2, -1], [x_m, 2, 1], size=(count, 3))


def test_opposite_sides_of_a_thin_wall_never_match():
    levels = levels_of(wall(0, 2.03), wall(1, 2.13), (ORIGIN_M, np.array([5.0, 0, 0])), (0.2,))
    fine = refine(np.eye(4)[None], levels)
    assert fine.matched[0] == 0
    np.testing.assert_array_equal(fine.T_target_source[0], np.eye(4))
    # The same two planes seen from one side are one surface, 10 cm off.
    levels = levels_of(wall(0, 2.03), wall(1, 2.13), sizes_m=(0.4,))
    fine = refine(np.eye(4)[None], levels)
    assert fine.matched[0] >= 50
    assert fine.T_target_source[0, 0, 3] == pytest.approx(0.1, abs=1e-3)


def test_one_plane_holds_one_translation_and_two_rotations():
    levels = levels_of(wall(0, 2.03), wall(1, 2.05), sizes_m=(0.4,))
    fine = refine(np.eye(4)[None], levels)
    held = np.linalg.eigvalsh(fine.information[0])
    assert (held > 1e-6 * held[-1]).sum() == 3
    share, directions = holds(fine.information[0], fine.matched[0])
    free = directions[is_weak(share, fine.matched[0])]
    assert free.shape == (2, 3)
    np.testing.assert_allclose(free[:, 0], 0, atol=1e-6)
    # What the plane does not hold stays where it was.
    np.testing.assert_allclose(fine.T_target_source[0, 1:3, 3], 0, atol=1e-6)


def test_the_information_predicts_the_scatter_of_the_result():
    """Ten noisy scans of one corner: errors along each axis match the stated covariance."""
    errors, stated = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        clouds_m = []
        for _ in range(2):
            points_m = rng.uniform(0.03, 3.03, size=(12_000, 3))
            points_m[np.arange(12_000), np.arange(12_000) % 3] = 0.03
            clouds_m.append(points_m + rng.normal(scale=0.01, size=points_m.shape))
        inside = (np.full(3, 2.0), np.full(3, 2.0))
        fine = refine(np.eye(4)[None], levels_of(*clouds_m, inside, (0.4, 0.2)))
        errors.append(fine.T_target_source[0, :3, 3])
        stated.append(np.sqrt(np.diag(np.linalg.inv(fine.information[0]))[3:]))
    scatter_m, stated_m = np.std(errors), np.mean(stated)
    assert 0.2 < scatter_m / stated_m < 5


def test_with_nothing_to_hold_on_to_the_start_is_returned():
    start = make_transform(np.eye(3), np.array([50.0, 0, 0]))
    fine = refine(start[None], levels_of(wall(0, 2.03), wall(1, 2.03)))
    np.testing.assert_array_equal(fine.T_target_source[0], start)
    assert fine.matched[0] == 0 and not fine.information.any()


@pytest.mark.parametrize(("turn_std_rad", "weakest_m"), [(0.01, 0.02), (0.001, 0.005)])
def test_the_weakest_motion_is_a_turn_or_a_shift(turn_std_rad, weakest_m):
    """Points 2 m from their centre, shifts known to 5 mm."""
    std = np.repeat([turn_std_rad, 0.005], 3)
    held = Refinement(
        T_target_source=np.eye(4)[None],
        information=np.diag(1 / std**2)[None],
        matched=np.array([100]),
        centre_m=np.zeros((1, 3)),
        spread_m=np.array([2.0]),
    )
    np.testing.assert_allclose(held.weakest_std_m, [weakest_m], rtol=1e-3)


def test_a_step_solves_the_damped_equations_about_the_matched_points_centre():
    rng = np.random.default_rng(4)
    J = rng.normal(size=(5, 200, 6)) * [3, 2, 1, 1, 1, 0.01]
    information = np.einsum("cki,ckj->cij", J, J)
    gradient = np.einsum("cki,ck->ci", J, rng.normal(scale=0.1, size=(5, 200)))
    information[4], gradient[4], matched = 0.0, 0.0, np.array([200] * 4 + [0])
    T = np.stack([make_transform(rotation_from_vector(v), v) for v in rng.normal(size=(5, 3))])
    centre_m = rng.normal(size=(5, 3))
    moved, moved_m = gauss_newton_step(
        T, Matches(matched, centre_m, np.ones(5), information, gradient)
    )
    farthest_m = 0.0
    for c in range(4):
        diagonal = np.diag(information[c])
        square_m2 = diagonal[:3].sum() / diagonal[3:].sum()
        one_voxel = DAMPING_VOXELS * diagonal[3:].sum() / 200
        damping = np.diag(one_voxel * np.repeat([square_m2, 1.0], 3))
        step = np.linalg.solve(information[c] + damping, gradient[c])
        motion = make_transform(rotation_from_vector(step[:3]), np.zeros(3))
        motion[:3, 3] = centre_m[c] + step[3:] - motion[:3, :3] @ centre_m[c]
        np.testing.assert_allclose(moved[c], motion @ T[c], atol=1e-12)
        turned_m = np.linalg.norm(step[:3]) * np.sqrt(square_m2)
        farthest_m = max(farthest_m, np.linalg.norm(step[3:]) + turned_m)
    np.testing.assert_allclose(moved[4], T[4], atol=1e-12)  # without matches it stays
    assert moved_m == pytest.approx(farthest_m)
