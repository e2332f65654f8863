"""Poses from planes: planted motions between sets of planes, and what planes cannot fix."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform, random_rotation, rotation_angle_rad
from skipnet.registration.hypotheses.planes import from_planes

VOXEL_M = 0.1
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def random_motion(seed):
    rng = np.random.default_rng(seed)
    return make_transform(random_rotation(rng), rng.normal(scale=3.0, size=3))


def planes_of(normals, centroids_m, weights):
    normals, centroids_m = np.asarray(normals, float), np.asarray(centroids_m, float)
    offsets_m = (normals * centroids_m).sum(axis=1)
    return Planes(normals, offsets_m, centroids_m, np.asarray(weights, float))


def moved(planes, T, keep=slice(None)):
    rotation, shift_m = T[:3, :3], T[:3, 3]
    return planes_of(
        planes.normals[keep] @ rotation.T,
        planes.centroids_m[keep] @ rotation.T + shift_m,
        planes.weights[keep],
    )


def room(seed=0):
    """Six walls of a box-shaped room, looking inwards, and four fronts of furniture within."""
    rng = np.random.default_rng(seed)
    fronts = rng.normal(size=(4, 3))
    fronts /= np.linalg.norm(fronts, axis=1, keepdims=True)
    normals = np.concatenate([AXES, fronts])
    centroids_m = np.concatenate([-AXES * [5.0, 4.0, 1.5], rng.uniform(-1.5, 1.5, size=(4, 3))])
    weights = [1200, 1500, 4000, 1200, 1500, 4000, 150, 120, 90, 80]
    return planes_of(normals, centroids_m, weights)


def errors(found, T_true):
    relative = found.T_target_source[:, :3, :3] @ T_true[:3, :3].T
    translation_m = np.linalg.norm(found.T_target_source[:, :3, 3] - T_true[:3, 3], axis=1)
    return rotation_angle_rad(relative), translation_m


@pytest.mark.parametrize("seed", range(4))
def test_the_planted_motion_is_among_the_candidates_of_a_room(seed):
    source, T_true = room(seed), random_motion(seed)
    found = from_planes(source, moved(source, T_true), VOXEL_M)
    assert 24 <= len(found) <= 60 * 120
    rotation_rad, translation_m = errors(found, T_true)
    assert ((rotation_rad < 1e-6) & (translation_m < 1e-6)).any()


def test_it_is_found_from_the_planes_that_both_scans_share():
    source, T_true = room(), random_motion(1)
    target = moved(source, T_true, keep=[0, 1, 2, 5, 6, 8])
    source = moved(source, np.eye(4), keep=[0, 1, 2, 3, 7, 8])
    rotation_rad, translation_m = errors(from_planes(source, target, VOXEL_M), T_true)
    assert ((rotation_rad < 1e-6) & (translation_m < 1e-6)).any()


def test_noise_on_the_planes_stays_noise_on_the_pose():
    rng = np.random.default_rng(5)
    source, T_true = room(), random_motion(2)
    target = moved(source, T_true)
    normals = target.normals + rng.normal(scale=0.003, size=target.normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    noisy = planes_of(normals, target.centroids_m, target.weights)
    rotation_rad, translation_m = errors(from_planes(source, noisy, VOXEL_M), T_true)
    assert ((rotation_rad < 0.02) & (translation_m < VOXEL_M)).any()


def test_all_four_turns_of_a_square_room_are_proposed():
    square = planes_of(AXES, -AXES * [5.0, 5.0, 1.5], [1500, 1500, 4000] * 2)
    found = from_planes(square, square, VOXEL_M)
    for quarter in range(4):
        c, s = np.round(np.cos(quarter * np.pi / 2)), np.round(np.sin(quarter * np.pi / 2))
        turn = make_transform(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.zeros(3))
        rotation_rad, translation_m = errors(found, turn)
        assert ((rotation_rad < 1e-6) & (translation_m < 1e-6)).any()


def test_normals_keep_their_side_so_no_mirrored_or_inside_out_pose_is_proposed():
    # The floor is no ceiling: whatever pose lays it on the target's only horizontal plane keeps
    # its upper side up.
    box = planes_of(
        [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]],
        [[0, 0, -1], [-4, 0, 0], [4, 0, 0], [0, -3, 0], [0, 3, 0]],
        [4000, 900, 900, 1200, 1200],
    )
    T_true = random_motion(3)
    found = from_planes(box, moved(box, T_true), VOXEL_M)
    rotations = found.T_target_source[:, :3, :3]
    assert len(found) >= 2  # as it stands, and turned by half a turn
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)
    up_cosine = rotations[:, :, 2] @ T_true[:3, 2]
    assert (up_cosine > 0.99).all()


@pytest.mark.parametrize("normals", [np.zeros((0, 3)), AXES[:2]], ids=["none", "two directions"])
def test_no_planes_and_planes_of_two_directions_fix_no_pose(normals):
    few = planes_of(normals, 2.0 * normals, np.full(len(normals), 100.0))
    assert len(from_planes(few, room(), VOXEL_M)) == 0
    assert len(from_planes(room(), few, VOXEL_M)) == 0


def test_parallel_planes_are_laid_on_each_other():
    # A wall on either side, 3 m apart, both facing the sensor between them.
    source = planes_of([[0, 1, 0], [0, -1, 0]], [[0.3, -1, 0], [-0.2, 2, 0.1]], [900, 600])
    for seed in range(3):
        T_true = random_motion(seed)
        found = from_planes(source, moved(source, T_true), VOXEL_M)
        assert len(found) == 2 * 2 * 2
        np.testing.assert_allclose(np.linalg.det(found.T_target_source[:, :3, :3]), 1.0)
        # Both walls end in their places for some candidate; the way along them is anyone's guess.
        normals = found.T_target_source[:, :3, :3] @ source.normals.T
        centroids_m = (
            found.T_target_source[:, :3, :3] @ source.centroids_m.T
            + found.T_target_source[:, :3, 3:]
        )
        target = moved(source, T_true)
        offsets_m = (normals * centroids_m).sum(axis=1)
        right = np.abs(normals - target.normals.T).max(axis=(1, 2)) < 1e-9
        right &= np.abs(offsets_m - target.offsets_m).max(axis=1) < 1e-9
        assert right.sum() >= 2
