"""Planes of a Skip-map: the faces of scenes whose planes are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.features.primitives import find_planes
from skipnet.geometry import random_rotation
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.skipmap import build_skipmap

NORMALS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
ROOM_M = np.array([6.2, 4.2, 3.0])


def room_points(count=60_000, sigma_m=0.003, seed=0):
    """The six inner faces of a box around the origin, evenly sampled, with noise."""
    rng = np.random.default_rng(seed)
    area = np.repeat([12.6, 18.6, 26.0], 2)
    face = rng.choice(6, size=count, p=area / area.sum())
    points_m = rng.uniform(-0.5, 0.5, size=(count, 3)) * ROOM_M
    rows, axis = np.arange(count), face // 2
    points_m[rows, axis] = (face % 2 - 0.5) * ROOM_M[axis]
    return points_m + rng.normal(scale=sigma_m, size=points_m.shape)


def test_the_six_faces_of_a_room_are_found_with_their_offsets_and_areas():
    planes = find_planes(build_skipmap(room_points(), 0.2, np.zeros(3)))
    assert len(planes) == 6
    face = (planes.normals @ NORMALS.T).argmax(axis=1)
    assert sorted(face) == list(range(6))
    np.testing.assert_allclose(planes.normals, NORMALS[face], atol=2e-3)
    np.testing.assert_allclose(planes.offsets_m, -0.5 * ROOM_M[face // 2], atol=2e-3)
    np.testing.assert_allclose((planes.normals * planes.centroids_m).sum(1), planes.offsets_m)
    # Heaviest first: floor and ceiling (26 m2), the long walls (19), the short ones (13).
    assert list(face // 2) == [2, 2, 1, 1, 0, 0]


def test_without_a_viewpoint_the_same_planes_come_with_a_sign_of_their_own():
    planes = find_planes(build_skipmap(room_points(), 0.2))
    both = planes.with_both_signs()
    assert len(planes) == 6 and len(both) == 12
    for normal, offset_m in zip(NORMALS, -0.5 * np.repeat(ROOM_M, 2), strict=True):
        for sign in (1, -1):
            agree = (both.normals @ (sign * normal) > 0.99) & (
                np.abs(both.offsets_m - sign * offset_m) < 0.01
            )
            assert agree.sum() == 1


def test_two_sides_of_a_thin_wall_are_two_planes_when_the_sensor_is_known():
    # Seen through a gap, both faces of a 12 cm wall are in one scan; the voxels are larger than it.
    rng = np.random.default_rng(0)
    near = rng.uniform([2, -3, 0], [2, 0, 3], size=(20_000, 3))
    far = rng.uniform([2.12, 1, 0], [2.12, 3, 3], size=(20_000, 3))
    skipmap = build_skipmap(np.concatenate([near, far]), 0.2, np.array([0.0, 0, 1.5]))
    away = skipmap.centroids_m[:, 1] > 0.5
    normals = skipmap.normals.copy()
    normals[away] *= -1  # as if seen from behind
    planes = find_planes(replace(skipmap, normals=normals))
    assert len(planes) == 2
    np.testing.assert_allclose(np.abs(planes.normals[:, 0]), 1.0, atol=1e-3)
    assert planes.normals[0] @ planes.normals[1] == pytest.approx(-1, abs=1e-3)


def test_a_room_in_any_attitude_gives_the_same_planes_turned():
    rotation = random_rotation(np.random.default_rng(4))
    planes = find_planes(build_skipmap(room_points() @ rotation.T, 0.2, np.zeros(3)))
    cosine = planes.normals[:6] @ (NORMALS @ rotation.T).T
    assert sorted(cosine.argmax(axis=1)) == list(range(6))
    assert cosine.max(axis=1).min() > np.cos(0.01)


def test_every_large_plane_of_a_simulated_room_is_a_surface_of_its_scene():
    pair = simulate_pair("oblique", 1, points=40_000)
    planes = find_planes(build_skipmap(pair.pair.target_m.astype(float), 0.15, np.zeros(3)))
    T = pair.target.T_world_sensor
    normals_world = planes.normals @ T[:3, :3].T
    points_world_m = planes.centroids_m @ T[:3, :3].T + T[:3, 3]
    scene = pair.scene
    corners_m = scene.vertices_m[scene.triangles[:, 0]]
    agree = normals_world @ scene.triangle_normals.T > np.cos(0.05)
    offset_m = np.einsum("ki,ti->kt", points_world_m, scene.triangle_normals) - np.einsum(
        "ti,ti->t", corners_m, scene.triangle_normals
    )
    large = planes.weights >= 60
    assert large.sum() >= 5
    assert (agree & (np.abs(offset_m) < 0.03)).any(axis=1)[large].all()


def test_no_plane_where_nothing_is_flat():
    ball = np.random.default_rng(0).normal(size=(20_000, 3))
    assert len(find_planes(build_skipmap(ball, 0.3))) == 0
