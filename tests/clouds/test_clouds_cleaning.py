"""Denoising against brute force, its invariants, and what ``validate`` refuses."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.clouds.cleaning import denoise, validate
from skipnet.geometry import make_transform, random_rotation, transform_points


def denoise_by_brute_force(points, neighbours, sigma):
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    mean = np.sort(distances, axis=1)[:, :neighbours].mean(axis=1)
    return mean <= mean.mean() + sigma * mean.std(ddof=1)


@pytest.fixture
def noisy_plane():
    rng = np.random.default_rng(5)
    plane = np.c_[rng.uniform(0, 3, size=(700, 2)), rng.normal(0, 0.003, size=700)]
    return np.concatenate([plane, rng.uniform(-3, 6, size=(60, 3))])


@pytest.mark.parametrize(("neighbours", "sigma"), [(4, 1.0), (1, 0.5), (10, 2.0), (4, 0.0)])
def test_denoise_equals_brute_force(noisy_plane, neighbours, sigma):
    np.testing.assert_array_equal(
        denoise(noisy_plane, neighbours, sigma),
        denoise_by_brute_force(noisy_plane, neighbours, sigma),
    )


def test_denoise_drops_stray_points_and_keeps_the_plane(noisy_plane):
    keep = denoise(noisy_plane)
    assert keep[:700].mean() > 0.99
    assert keep[700:].mean() < 0.15


def test_denoise_ignores_the_frame_and_follows_the_order(noisy_plane):
    rng = np.random.default_rng(0)
    moved = transform_points(
        make_transform(random_rotation(rng), np.array([50.0, -20, 3])), noisy_plane
    )
    shuffle = rng.permutation(len(noisy_plane))
    np.testing.assert_array_equal(denoise(moved), denoise(noisy_plane))
    np.testing.assert_array_equal(denoise(noisy_plane[shuffle]), denoise(noisy_plane)[shuffle])


def test_denoise_keeps_all_at_infinite_sigma_and_copes_with_equal_points(noisy_plane):
    assert denoise(noisy_plane, sigma=np.inf).all()
    assert denoise(np.ones((10, 3))).all()


@pytest.mark.parametrize("arguments", [{"neighbours": 0}, {"sigma": -1.0}, {"neighbours": 9}])
def test_denoise_refuses_bad_arguments(arguments):
    with pytest.raises(ValueError, match="expected|need"):
        denoise(np.random.default_rng(0).normal(size=(9, 3)), **arguments)


def test_validate_returns_floats_of_array_likes_and_copies_none_that_are():
    points = validate([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "source")
    assert points.dtype == np.float64 and points.shape == (3, 3)
    for kind in (np.float32, np.float64):
        floats = np.random.default_rng(0).normal(size=(10, 3)).astype(kind)
        assert validate(floats, "source") is floats
        for view in (np.hstack([floats, floats])[:, :3], np.asfortranarray(floats)):
            whole = validate(view, "source")
            assert whole.flags.c_contiguous and whole.dtype == kind
            np.testing.assert_array_equal(whole, floats)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (np.zeros((4, 2)), r"shape \(4, 2\)"),
        (np.zeros(3), r"shape \(3,\)"),
        ([["a", "b", "c"]], r"expected numbers of shape \(N, 3\)"),
        (np.zeros((4, 3), dtype=complex), "complex128"),
        (np.empty((0, 3)), "got 0 points"),
        ([[0, 0, 0], [1, 0, 0]], "got 2 points"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], "1 of 3 points hold NaN"),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], "1 of 3 points hold NaN"),
        (np.ones((10, 3)), "in one place"),
        (np.linspace(0, 1, 10)[:, None] * [[1.0, 2, 3]] + [100, 200, 300], "on one line"),
    ],
)
def test_validate_refuses(points, words):
    with pytest.raises(ValueError, match=words) as refusal:
        validate(points, "target")
    assert str(refusal.value).startswith("target: ")


def test_validate_accepts_a_bare_plane_far_from_the_origin():
    plane = np.c_[np.random.default_rng(1).uniform(size=(100, 2)), np.zeros(100)]
    assert len(validate(plane + [5e5, 5e6, 100], "source")) == 100


def test_validate_looks_at_every_point_before_it_calls_them_a_line():
    points = np.zeros((5000, 3))
    points[:, 0] = np.arange(5000)
    points[1, 1] = 3.0
    assert validate(points, "source") is points
