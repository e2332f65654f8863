"""Scans of a few lines: GICP finds what voxels cannot, and says how firmly it holds."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, make_transform, pose_error, rotation_from_vector
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.alignment.sparse import refine_sparse
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
    points_m = np.asarray(clouds[0][0].points())[:, :3]
    from_centre_m = np.linalg.norm(points_m - points_m.mean(axis=0), axis=1)
    np.testing.assert_allclose(fine.spread_m, np.sqrt((from_centre_m**2).mean()))


def test_the_stated_rotation_covariance_covers_the_error(rings, clouds):
    from scipy.spatial.transform import Rotation

    fine = refine_sparse(started_from(rings.T_target_source[None]), *clouds, SIZE_M)
    turned = fine.T_target_source[0] @ invert(rings.T_target_source)
    error_rad = Rotation.from_matrix(turned[:3, :3]).as_rotvec()
    squared = error_rad @ np.linalg.solve(fine.covariance[0][:3, :3], error_rad) / 3
    assert 0.01 < squared < 6


def test_a_pose_far_from_every_surface_stays_where_it_was(rings, clouds):
    far = make_transform(np.eye(3), np.array([500.0, 0, 0]))[None]
    fine = refine_sparse(started_from(far), *clouds, SIZE_M)
    np.testing.assert_array_equal(fine.T_target_source, far)
    assert fine.matched[0] == 0
