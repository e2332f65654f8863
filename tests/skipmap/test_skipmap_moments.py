"""Moments: against NumPy's covariance and scikit-learn's PCA on the actual points."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, random_rotation, transform_points
from skipnet.skipmap.cells import pack
from skipnet.skipmap.moments import (
    add_neighbours,
    add_up,
    curvature,
    moments_of_points,
    principal_axes,
    sum_groups,
)

SIZES = [1, 2, 7, 100]
STARTS = np.cumsum([0, *SIZES[:-1]])


def in_segments(moments, starts):
    """Consecutive rows added up; segment i runs from ``starts[i]`` to ``starts[i + 1]``."""
    segment = np.searchsorted(starts, np.arange(len(moments)), side="right") - 1
    return add_up(moments, segment, len(starts))


@pytest.fixture
def points_m():
    return np.random.default_rng(0).normal([1, -2, 3], [2.0, 0.5, 0.1], size=(sum(SIZES), 3))


@pytest.fixture
def moments(points_m):
    return in_segments(moments_of_points(points_m), STARTS)


def test_count_mean_and_covariance_are_those_of_the_points(points_m, moments):
    for row, (start, size) in enumerate(zip(STARTS, SIZES, strict=True)):
        group_m = points_m[start : start + size]
        assert moments.count[row] == size
        np.testing.assert_allclose(moments.mean[row], group_m.mean(axis=0))
        expected = np.cov(group_m.T, bias=True) if size > 1 else np.zeros((3, 3))
        np.testing.assert_allclose(moments.covariance[row], expected, atol=1e-13)


def test_moments_add_and_subtract_as_point_sets_join_and_part(points_m):
    first, second = (in_segments(moments_of_points(p), [0]) for p in (points_m[:40], points_m[40:]))
    whole = in_segments(moments_of_points(points_m), [0])
    np.testing.assert_allclose((first + second).covariance, whole.covariance)
    np.testing.assert_allclose((whole - first).covariance, second.covariance, atol=1e-13)
    np.testing.assert_allclose((whole - first).mean, second.mean)
    assert (whole - first).count == len(points_m) - 40


def test_principal_axes_are_scikit_learns(points_m, moments):
    from sklearn.decomposition import PCA

    values, axes = principal_axes(moments)
    pca = PCA().fit(points_m[STARTS[3] :])
    share = (SIZES[3] - 1) / SIZES[3]  # scikit-learn divides by n - 1
    np.testing.assert_allclose(values[3], pca.explained_variance_[::-1] * share)
    alignment = np.abs(np.einsum("ki,ik->k", pca.components_[::-1], axes[3]))
    np.testing.assert_allclose(alignment, 1.0)


def test_curvature_runs_from_a_plane_to_a_ball_and_takes_coinciding_points():
    rng = np.random.default_rng(1)
    plane = rng.uniform(size=(500, 3)) * [1, 1, 0]
    ball = rng.normal(size=(200_000, 3))
    one_place = np.ones((4, 3))
    stacked = moments_of_points(np.concatenate([plane, ball, one_place]))
    grouped = in_segments(stacked, np.array([0, 500, 200_500]))
    np.testing.assert_allclose(curvature(principal_axes(grouped)[0]), [0, 1 / 3, 0], atol=0.01)


def test_two_perpendicular_half_planes_have_the_curvature_worked_out_by_hand():
    # Squares [0, 1]^2 in the planes z = 0 and x = 0, meeting along the y axis. Over both,
    # E x = 1/4, E x^2 = 1/6, E xz = 0: var x = var z = 5/48, cov xz = -1/16, var y = 1/12.
    # So l0 = 2/48, the sum of all is 14/48, and their ratio 1/7.
    u, v = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(400) + 0.5) / 400)
    floor = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    wall = np.stack([np.zeros_like(u), v, u], axis=-1).reshape(-1, 3)
    moments = in_segments(moments_of_points(np.concatenate([floor, wall])), [0])
    assert curvature(principal_axes(moments)[0])[0] == pytest.approx(1 / 7, abs=1e-4)


def test_moved_moments_are_those_of_the_moved_points(points_m):
    rng = np.random.default_rng(5)
    rotation, shift_m = random_rotation(rng), rng.normal(size=3)
    moved = moments_of_points(points_m).moved(rotation, shift_m)
    expected = moments_of_points(points_m @ rotation.T + shift_m)
    np.testing.assert_allclose(moved.sums, expected.sums, rtol=1e-10, atol=1e-12)


def test_points_are_moved_while_they_are_added_up(points_m):
    rng = np.random.default_rng(6)
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    group = rng.integers(3, size=len(points_m))
    expected = add_up(moments_of_points(transform_points(T, points_m)), group, 3)
    np.testing.assert_allclose(sum_groups(points_m, group, 3, T).sums, expected.sums, atol=1e-10)


@pytest.mark.parametrize("extent", [2, 9, 4000])
def test_neighbours_are_those_that_a_dict_finds(extent):
    rng = np.random.default_rng(7)
    cells = np.unique(rng.integers(-extent, extent, size=(600, 3)), axis=0)
    cells = np.concatenate([cells, cells[-50:] + [0, 0, 1], cells[:50] + [9 * extent, 0, 0]])
    cells = np.unique(cells, axis=0)
    own = moments_of_points(rng.normal(size=(len(cells), 3)))
    row_of = {tuple(cell): row for row, cell in enumerate(cells)}
    expected = np.zeros_like(own.sums)
    for row, cell in enumerate(cells):
        for step in np.ndindex(3, 3, 3):
            near = row_of.get(tuple(cell + step - 1))
            if near is not None:
                expected[row] += own.sums[near]
    steps = np.array([(x, y, 0) for x in (-1, 0, 1) for y in (-1, 0, 1)])
    around = add_neighbours(own, pack(cells), pack(steps) - pack(np.zeros(3, dtype=np.int64)))
    np.testing.assert_allclose(around.sums, expected, atol=1e-12)


def test_rows_are_selected_by_index_mask_and_slice(moments):
    for rows in (np.array([3, 1]), np.array([True, False, True, False]), slice(1, 3)):
        np.testing.assert_array_equal(moments[rows].first, moments.first[rows])
        assert len(moments[rows]) == 2
