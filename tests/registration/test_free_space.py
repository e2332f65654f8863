"""What counts as standing in free space that the other sensor saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import FINE
from skipnet.registration.judging.states import facing, states
from skipnet.scans.describing import describe
from skipnet.simulation.scanning.pairs import simulate_scans


def test_only_what_is_turned_to_the_sensor_contradicts_where_that_is_asked():
    clouds_m = [s.points_m for s in simulate_scans("paper_room", 2, 2, points=20_000)[0]]
    source, target = (one.evidence for one in describe(clouds_m, ["auto", "auto"]))
    T = np.stack([np.eye(4), np.eye(4)])
    T[1, :3, 3] = [0.7, 0.4, 0.1]  # somewhere wrong: walls stand in the room
    least = 0.26
    free = states(T, source, target, 3000, FINE)[2]
    kept = states(T, source, target, 3000, replace(FINE, min_facing_cosine=least))[2]
    expected = np.zeros_like(free)
    for pose, voxel in np.argwhere(free):
        moved_m = T[pose, :3, :3] @ source.points_m[voxel] + T[pose, :3, 3]
        ray_m = moved_m - target.range_image.viewpoint_m
        cosine = abs(ray_m @ T[pose, :3, :3] @ source.normals[voxel]) / np.linalg.norm(ray_m)
        expected[pose, voxel] = cosine >= least
    np.testing.assert_array_equal(kept, expected)
    assert 0 < kept.sum() < free.sum()


def test_what_moves_within_its_surface_tells_nothing():
    rng = np.random.default_rng(0)
    points_m, normals = (rng.normal(size=(200, 3)).astype(np.float32) for _ in range(2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    T = np.stack([np.eye(4)] * 4)
    T[0, :3, :3] = T[1, :3, :3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    T[1, :3, 3], T[2, :3, 3] = [0.1, 0, 0], [3, 2, 1]
    T[3] = T[0]
    told = facing(T, points_m, normals)
    turned, moved_m = normals @ T[0, :3, :3].T, points_m + [3, 2, 1] - points_m @ T[0, :3, :3].T
    np.testing.assert_allclose(told[0], turned[:, 0] ** 2, atol=1e-6)
    cosine = (moved_m * turned).sum(axis=1) / np.linalg.norm(moved_m, axis=1)
    np.testing.assert_allclose(told[1], cosine**2, atol=1e-6)
    np.testing.assert_array_equal(told[2], 0)


def test_the_judge_of_pairs_asks_every_voxel():
    clouds_m = [s.points_m for s in simulate_scans("paper_room", 2, 2, points=20_000)[0]]
    source, target = (one.evidence for one in describe(clouds_m, ["auto", "auto"]))
    T = np.eye(4)[None].copy()
    T[0, :3, 3] = [0.7, 0.4, 0.1]
    judge = Judge(source, target, 3000, 10.0)
    wary = judge.score(T, replace(FINE, min_facing_cosine=0.26)).violation
    assert 0 < wary[0] < judge.score(T).violation[0]
