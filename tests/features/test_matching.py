"""Which descriptors are near each other, beside plain sorting."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.features.matching import mutual_nearest, mutually_near
from skipnet.features.nearest import nearest_of_many


def test_one_choice_is_the_mutual_nearest() -> None:
    rng = np.random.default_rng(0)
    source, target = (rng.normal(size=(n, 6)).astype(np.float32) for n in (300, 500))
    for found, expected in zip(
        mutually_near(source, target, 1), mutual_nearest(source, target), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("count", [2, 5])
def test_each_is_among_the_nearest_of_the_other(count: int) -> None:
    rng = np.random.default_rng(1)
    source, target = (rng.normal(size=(n, 4)).astype(np.float32) for n in (40, 60))
    distance = np.linalg.norm(source[:, None] - target, axis=2)
    of_source, of_target = (np.argsort(np.argsort(distance, axis=a), axis=a) for a in (1, 0))
    expected = np.argwhere((of_source < count) & (of_target < count))
    rows_s, rows_t, apart = mutually_near(source, target, count)
    np.testing.assert_array_equal(np.stack([rows_s, rows_t], axis=1), expected)
    np.testing.assert_allclose(apart, distance[rows_s, rows_t], rtol=1e-5)


def test_fewer_descriptors_than_choices_are_all_near() -> None:
    source = np.eye(4, dtype=np.float32)
    assert len(mutually_near(source[:1], source[1:3], 5)[0]) == 2
    assert len(mutually_near(source[:0], source, 3)[0]) == 0


@pytest.mark.parametrize("size", [(700, 900, 33), (40, 3000, 7), (900, 1, 2), (3, 130, 1)])
def test_nearest_of_many_are_what_all_distances_say(size: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(2)
    spread = 0.5 ** np.arange(size[2])  # most lies along a few axes, as with histograms
    source, target = ((spread * rng.normal(size=(n, size[2]))).astype(np.float32) for n in size[:2])
    distance = np.linalg.norm(source[:, None].astype(np.float64) - target, axis=2)
    forward, back = distance.argmin(axis=1), distance.argmin(axis=0)
    expected = np.flatnonzero(back[forward] == np.arange(len(source)))
    rows_s, rows_t = nearest_of_many(source, target)
    np.testing.assert_array_equal(rows_s, expected)
    np.testing.assert_array_equal(rows_t, forward[expected])


def test_of_equal_descriptors_one_is_taken() -> None:
    source = np.repeat(np.eye(5, dtype=np.float32), 60, axis=0)
    rows_s, rows_t = nearest_of_many(source, source[::-1].copy())
    assert len(rows_s) == len(set(rows_s)) == len(set(rows_t)) == 5
    np.testing.assert_array_equal(source[rows_s], source[::-1][rows_t])
