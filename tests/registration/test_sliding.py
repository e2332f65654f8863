"""Sliding along weak directions: the judge finds the place, or that there is none."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.features.primitives import find_planes
from skipnet.geometry import (
    make_transform,
    random_rotation,
    rotation_angle_rad,
    rotation_from_vector,
)
from skipnet.registration.alignment.refinement import refine
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.sliding import (
    MIN_DETERMINED,
    gains_much,
    holds,
    holds_against,
    is_weak,
    moves_freely,
    slide,
    weak_motions,
)
from skipnet.scans.evidence import build_evidence
from skipnet.scans.range_image import build_range_image
from skipnet.scans.worth import voxel_worth
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.15
ALONG, ACROSS = np.eye(3)[0], np.eye(3)[1]
HOW = (4000, 10.0)


def tube(ends: bool, count=60_000, half_m=(6.0, 1.0, 1.2)):
    """Inner faces of a corridor along x around the sensor, with end walls or without."""
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-1, 1, size=(count, 3)) * half_m
    face = rng.choice([2, 3, 4, 5, *([0, 1] if ends else [])], size=count)
    side = half_m * np.ones((count, 3))
    rows = np.arange(count)
    points_m[rows, face // 2] = (side * (2 * (face % 2)[:, None] - 1))[rows, face // 2]
    return points_m + 0.02


def shift(direction):
    """A motion without a turn."""
    return np.append(np.zeros(3), direction)


def evidence_of(points_m):
    skipmap = build_skipmap(points_m, VOXEL_M, np.zeros(3))
    image = build_range_image(points_m, np.zeros(3))
    evidence = build_evidence(skipmap, image, np.random.default_rng(0))
    return evidence.valued(voxel_worth(skipmap, find_planes(skipmap)))


@pytest.fixture(scope="module")
def closed():
    return evidence_of(tube(ends=True))


@pytest.fixture(scope="module")
def open_ended():
    return evidence_of(tube(ends=False))


@pytest.mark.parametrize("shift_m", [-0.2, 0.1, 0.25])
def test_end_walls_bring_a_shifted_pose_back(closed, shift_m):
    start = make_transform(np.eye(3), shift_m * ALONG)
    slid = slide(start, shift(ALONG), np.zeros(3), Judge(closed, closed, *HOW))
    assert abs(slid[0, 3]) < 0.25 * VOXEL_M
    np.testing.assert_array_equal(slid[1:], start[1:])
    assert not moves_freely(shift(ALONG), np.eye(4), np.zeros(3), Judge(closed, closed, *HOW))


def test_nothing_holds_a_pose_along_an_open_corridor(open_ended):
    case = np.eye(4), np.zeros(3), Judge(open_ended, open_ended, *HOW)
    assert moves_freely(shift(ALONG), *case)
    assert not moves_freely(shift(ACROSS), *case)


def ball(seed, bump_m, count=150_000, radius_m=2.0):
    """A ball at (3, 0, 0) seen from everywhere, with a dent or bump on one side."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    height_m = bump_m * np.exp(-8 * (1 - ways[:, 0])) * (1 + 0.5 * ways[:, 1])
    return (radius_m + height_m)[:, None] * ways + [3.0, 0, 0]


def test_a_ball_on_a_ball_turns_freely_about_its_middle_and_one_with_a_bump_does_not():
    held = []
    for bump_m in (0.0, 0.8):
        scans = [build_skipmap(ball(seed, bump_m), VOXEL_M) for seed in (0, 1)]
        fine = refine(np.eye(4)[None], [(scans[0], scans[1])])
        share, motions = holds_against(fine.information[0], fine.matched[0], fine.spread_m[0])
        held.append(share)
        evidence = [build_evidence(scan, None, np.random.default_rng(0)) for scan in scans]
        case = fine.T_target_source[0], fine.centre_m[0], Judge(*evidence, *HOW)
        free = [moves_freely(motion, *case) for motion in motions]
        if bump_m == 0:
            # Three turns about the middle of the ball, wherever the scans' origin is.
            assert (share[:3] < MIN_DETERMINED).all() and (share[3:] > 0.2).all()
            assert free == [True] * 3 + [False] * 3
            for motion in motions[:3]:
                middle_m = np.array([3.0, 0, 0]) - fine.centre_m[0]
                moved_m = np.cross(motion[:3], middle_m) + motion[3:]
                assert np.linalg.norm(moved_m) < 0.1 * np.linalg.norm(motion[:3])
        else:
            assert not any(free[2:])
    assert (held[1][2:] > 10 * held[0][2]).all()


def test_the_share_of_a_motion_does_not_depend_on_unit_or_frame():
    rng = np.random.default_rng(0)
    points_m, normals = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shares = []
    for scale, turn in ((1.0, np.eye(3)), (1000.0, random_rotation(rng))):
        moved_m, turned = scale * points_m @ turn.T, normals @ turn.T
        lever_m = moved_m - moved_m.mean(axis=0)
        jacobian = np.hstack([np.cross(lever_m, turned), turned])
        spread_m = np.sqrt((lever_m**2).sum(axis=1).mean())
        shares.append(holds_against(jacobian.T @ jacobian, 50, spread_m)[0])
    np.testing.assert_allclose(shares[0], shares[1], rtol=1e-9)


def test_without_matches_nothing_is_held():
    assert not holds_against(np.zeros((6, 6)), 0, 0.0)[0].any()


def test_few_voxels_tell_whether_a_slide_gains_much(closed, open_ended):
    off_m = 2 * VOXEL_M
    for evidence, expected in ((closed, True), (open_ended, False)):
        judge = Judge(evidence, evidence, *HOW)
        along, across = ((shift(way), np.zeros(3), judge) for way in (ALONG, ACROSS))
        assert not gains_much(np.eye(4), *along)
        assert gains_much(make_transform(np.eye(3), off_m * ACROSS), *across)
        # Along the corridor only end walls make a place better than another.
        assert gains_much(make_transform(np.eye(3), off_m * ALONG), *along) == expected


def tank(seed, fitting, count=120_000, radius_m=3.0, high_m=4.0):
    """Wall, floor and roof of a round tank around the sensor, with a box at its wall or without."""
    rng = np.random.default_rng(seed)
    angle, z_m = rng.uniform(0, 2 * np.pi, count), rng.uniform(-1.5, high_m - 1.5, count)
    wall_m = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), z_m], axis=1)
    flat_m = rng.uniform(-radius_m, radius_m, (count // 2, 3))
    flat_m[:, 2] = rng.choice([-1.5, high_m - 1.5], len(flat_m))
    flat_m = flat_m[np.linalg.norm(flat_m[:, :2], axis=1) < radius_m]
    box_m = rng.uniform([2.2, -0.4, -0.5], [2.9, 0.4, 0.5], (count // 20, 3))
    side = np.array([2.2, -0.4, 0.4])[rng.integers(3, size=len(box_m))]
    box_m[side == 2.2, 0] = 2.2
    box_m[side != 2.2, 1] = side[side != 2.2]
    points_m = np.concatenate([wall_m, flat_m, *([box_m] if fitting else [])])
    return points_m + rng.normal(0, 0.003, points_m.shape)


@pytest.mark.parametrize("fitting", [True, False])
def test_what_stands_at_its_wall_brings_a_turned_tank_back(fitting):
    scans_m = [tank(seed, fitting) for seed in (1, 2)]
    scans = [build_skipmap(points_m, VOXEL_M, np.zeros(3)) for points_m in scans_m]
    turned = make_transform(rotation_from_vector(np.array([0, 0, 0.08])), np.zeros(3))
    fine = refine(turned[None], [(scans[0], scans[1])], max_steps=1)
    hold = fine.information[0], fine.matched[0], fine.spread_m[0]
    # Normals hold all its places; of the turns that about its axis is held by noise alone.
    motions = weak_motions(*hold, may_turn=True)
    assert len(weak_motions(*hold, may_turn=False)) == 0
    assert len(motions) == 1 and not is_weak(holds(*hold[:2])[0], hold[1]).any()
    axis = motions[0, :3] / np.linalg.norm(motions[0, :3])
    assert abs(axis[2]) > 0.99
    judge = Judge(*(evidence_of(points_m) for points_m in scans_m), *HOW)
    case = motions[0], fine.centre_m[0], judge
    slid = slide(turned, *case)
    left_m = 3.0 * rotation_angle_rad(slid[:3, :3])
    if fitting:
        assert left_m < 0.5 * VOXEL_M < 3.0 * 0.08
        assert not moves_freely(case[0], np.eye(4), *case[1:])
    else:
        assert moves_freely(case[0], np.eye(4), *case[1:])


def test_a_held_pose_has_no_weak_motion_and_a_corridor_its_own():
    rng = np.random.default_rng(0)
    for face, expected in ((np.eye(3), 0), (np.eye(3)[1:], 1)):
        points_m = rng.normal(size=(600, 3))
        normals = face[rng.integers(len(face), size=600)]
        lever_m = points_m - points_m.mean(axis=0)
        jacobian = np.hstack([np.cross(lever_m, normals), normals])
        spread_m = np.sqrt((lever_m**2).sum(axis=1).mean())
        motions = weak_motions(jacobian.T @ jacobian, 600, spread_m, may_turn=True)
        assert len(motions) == expected
        np.testing.assert_allclose(np.abs(motions), np.array([shift(ALONG)])[:expected], atol=1e-9)
