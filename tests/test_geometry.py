"""Sums over points against NumPy; rotations against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skipnet.clouds.statistics import bounds, central_moments
from skipnet.geometry import invert, make_transform, nearest, rotation_from_vector, straightened


@pytest.fixture(params=[np.float32, np.float64])
def points_m(request):
    """Far from the origin, skewed, and more than one block of sums."""
    points_m = np.random.default_rng(0).gamma(2.0, size=(50_000, 3)) * [3.0, 2.0, 0.5]
    return (points_m + [100.0, -20.0, 5.0]).astype(request.param)


def test_bounds_are_those_of_the_points(points_m):
    low_m, high_m = bounds(points_m)
    np.testing.assert_array_equal(low_m, points_m.min(axis=0))
    np.testing.assert_array_equal(high_m, points_m.max(axis=0))


def test_central_moments_are_sums_over_the_centred_points(points_m):
    mean_m, second, third = central_moments(points_m)
    centred = points_m.astype(np.float64) - points_m.mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(mean_m, points_m.mean(axis=0, dtype=np.float64), rtol=1e-12)
    np.testing.assert_allclose(second, centred.T @ centred, rtol=1e-9)
    expected = np.einsum("ni,nj,nk->ijk", centred, centred, centred)
    np.testing.assert_allclose(third, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_rotations_are_scipys_from_none_to_a_whole_turn():
    directions = np.random.default_rng(3).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    angles_rad = np.concatenate([np.zeros(1), np.geomspace(1e-12, 2 * np.pi, 198), [np.pi]])
    vectors_rad = directions * angles_rad[:, None]
    expected = Rotation.from_rotvec(vectors_rad).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(vectors_rad), expected, atol=2e-15)
    np.testing.assert_array_equal(
        rotation_from_vector(vectors_rad[7]), rotation_from_vector(vectors_rad)[7]
    )


def test_the_nearest_of_other_points_is_that_of_scipy():
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(3)
    for kind, count in ((np.float64, 3000), (np.float32, 2), (np.float64, 1)):
        from_m, to_m = (rng.normal(size=(rows, 3)).astype(kind) for rows in (500, count))
        away_m, rows = nearest(from_m, to_m)
        expected_m, expected = cKDTree(to_m.astype(np.float64)).query(from_m.astype(np.float64))
        np.testing.assert_allclose(away_m, expected_m, rtol=1e-12)
        assert (rows == expected).all()


def test_a_transform_that_rounding_has_bent_is_made_rigid():
    rotation = Rotation.random(rng=np.random.default_rng(0)).as_matrix()
    bent = make_transform(rotation + 1e-5, np.array([1.0, 2.0, 3.0]))
    assert np.abs(bent @ invert(bent) - np.eye(4)).max() > 1e-6
    straight = straightened(bent)
    np.testing.assert_allclose(straight @ invert(straight), np.eye(4), atol=1e-8)
    np.testing.assert_allclose(straight, bent, atol=1e-4)
