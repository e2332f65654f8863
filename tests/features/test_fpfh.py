"""Tests for fast point feature histograms, against Open3D's."""

import numpy as np
import open3d as o3d
import pytest

from skipnet.features.fpfh import point_feature_histograms


def _by_open3d(points_m: np.ndarray, normals: np.ndarray, radius_m: float) -> np.ndarray:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    within = o3d.geometry.KDTreeSearchParamHybrid(radius_m, len(points_m))
    return np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, within).data).T


@pytest.mark.parametrize("extent_m", [(4.0, 3.0, 2.0), (30.0, 1.0, 0.5), (0.5, 0.5, 0.5)])
def test_histograms_are_open3ds(extent_m: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(5)
    points_m = rng.uniform(-0.5, 0.5, (400, 3)) * extent_m + 7
    normals = rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ours = point_feature_histograms(points_m, normals, 0.6)
    assert ours.dtype == np.float32 and ours.max() > 0
    np.testing.assert_allclose(ours, _by_open3d(points_m, normals, 0.6), atol=2e-3)


def test_turning_the_points_changes_nothing() -> None:
    rng = np.random.default_rng(6)
    points_m, normals = rng.normal(size=(2, 200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    before = point_feature_histograms(points_m, normals, 1.0)
    after = point_feature_histograms(points_m @ turn.T + 3, normals @ turn.T, 1.0)
    np.testing.assert_allclose(after, before, atol=2e-3)


def test_points_without_neighbours_and_points_that_coincide_have_no_histogram() -> None:
    points_m = np.array([[0.0, 0, 0], [0, 0, 0], [9, 9, 9]])
    normals = np.tile([0.0, 0, 1], (3, 1))
    assert not point_feature_histograms(points_m, normals, 1.0).any()
    assert point_feature_histograms(points_m[:0], normals[:0], 1.0).shape == (0, 33)
