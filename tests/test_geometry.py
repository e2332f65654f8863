"""Sums over points, taken in chunks, against NumPy on the whole array; rotations against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skipnet.geometry import (
    bounds,
    central_moments,
    columns,
    make_transform,
    rotation_from_vector,
)


@pytest.fixture(params=[np.float32, np.float64])
def points_m(request):
    """More than are taken at a time."""
    points_m = np.random.default_rng(0).gamma(2.0, size=(50_000, 3)) * [3.0, 2.0, 0.5]
    return (points_m + [100.0, -20.0, 5.0]).astype(request.param)


def test_columns_walk_through_all_points_and_move_them(points_m):
    turn = make_transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
    moved_m = points_m.astype(np.float64) @ turn[:3, :3].T + turn[:3, 3]
    for T, expected_m in ((None, points_m), (turn, moved_m)):
        chunks = list(columns(points_m, T, 20_000))
        assert len(chunks) == 3 and {chunk.dtype for chunk in chunks} == {np.dtype(np.float64)}
        np.testing.assert_allclose(np.concatenate(chunks, axis=1).T, expected_m, rtol=1e-12)


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
