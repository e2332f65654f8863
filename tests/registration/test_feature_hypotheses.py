"""Corners and edges read off a box-shaped room, and the poses they propose."""

import numpy as np
import pytest

from skipnet.features.keypoints import Corners, Lines, find_corners, find_lines
from skipnet.geometry import invert, make_transform, pose_error, random_rotation, transform_points
from skipnet.registration.hypotheses.corners_edges import from_corners, from_edges
from skipnet.skipmap.skipmap import build_skipmap
from skipnet.types import FeatureClass

HALF_M = np.array([2.53, 1.71, 1.27])
VOXEL_M = 0.1


@pytest.fixture(scope="module")
def room():
    """Skip-map of a closed box seen from its centre, and the corner and edge voxels' rows."""
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-1, 1, (120_000, 3)) * HALF_M
    side = rng.choice(3, len(points_m), p=(HALF_M.prod() / HALF_M) / (HALF_M.prod() / HALF_M).sum())
    row = np.arange(len(points_m))
    points_m[row, side] = np.sign(points_m[row, side]) * HALF_M[side]
    skipmap = build_skipmap(points_m, VOXEL_M, np.zeros(3))
    near_wall = np.abs(np.abs(skipmap.centroids_m) - HALF_M) < 0.75 * VOXEL_M
    count = near_wall.sum(axis=1)
    return skipmap, np.flatnonzero(count == 3), np.flatnonzero(count == 2)


def test_a_box_has_eight_corners_where_its_walls_meet(room):
    skipmap, corner_rows, _ = room
    classes = np.full(len(corner_rows), FeatureClass.FIRST_CORNER)
    corners = find_corners(skipmap, corner_rows, classes, np.ones(len(corner_rows)))
    assert len(corners) == 8
    assert {tuple(sign) for sign in np.sign(corners.points_m)} == {
        (x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)
    }
    np.testing.assert_allclose(np.abs(corners.points_m), np.tile(HALF_M, (8, 1)), atol=0.03)


def test_a_box_has_twelve_edges_along_its_axes(room):
    skipmap, _, edge_rows = room
    lines = find_lines(skipmap, edge_rows)
    strong = lines.weights > 10
    assert strong.sum() == 12
    np.testing.assert_allclose(np.abs(lines.directions[strong]).max(axis=1), 1, atol=1e-3)


def motion(seed):
    rng = np.random.default_rng(seed)
    return make_transform(random_rotation(rng), rng.uniform(-3, 3, 3))


def nearest(hypotheses, T_true):
    errors = np.array([pose_error(T, T_true) for T in hypotheses.T_target_source])
    return errors[errors.sum(axis=1).argmin()]


@pytest.mark.parametrize("seed", range(3))
def test_corners_of_equal_class_propose_the_motion(seed):
    rng = np.random.default_rng(seed)
    target_m = rng.uniform(-4, 4, (12, 3))
    classes = rng.integers(0, 3, 12)
    T = motion(seed)
    target = Corners(target_m, classes, np.ones(12))
    source = Corners(transform_points(invert(T), target_m), classes, np.ones(12))
    with_class = from_corners(source, target, VOXEL_M)
    assert nearest(with_class, T) == pytest.approx((0, 0), abs=1e-6)
    without = from_corners(source, target, VOXEL_M, same_class=False)
    right = [
        np.mean([sum(pose_error(pose, T)) < 0.1 for pose in found.T_target_source])
        for found in (with_class, without)
    ]
    assert right[0] >= right[1]  # classes rule wrong correspondences out


@pytest.mark.parametrize("seed", range(3))
def test_two_edges_fix_the_motion(seed):
    rng = np.random.default_rng(seed)
    points_m, directions = rng.uniform(-4, 4, (6, 3)), rng.normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    T = motion(seed)
    target = Lines(points_m, directions, np.ones(6))
    turned = -directions @ invert(T)[:3, :3].T  # an edge has no sign
    source = Lines(transform_points(invert(T), points_m), turned, np.ones(6))
    assert nearest(from_edges(source, target, VOXEL_M), T) == pytest.approx((0, 0), abs=1e-6)


def test_nothing_comes_from_nothing():
    none = Corners(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0))
    assert len(from_corners(none, none, VOXEL_M)) == 0
    parallel = Lines(np.eye(3), np.tile([0.0, 0, 1], (3, 1)), np.ones(3))
    assert len(from_edges(parallel, parallel, VOXEL_M)) == 0
