"""Sliding along weak directions: the judge finds the place, or that there is none."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform
from skipnet.registration.sliding import slide, slides_freely
from skipnet.registration.verification import build_evidence
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.15
ALONG, ACROSS = np.eye(3)[0], np.eye(3)[1]
CASE = (4000, 10.0)


def tube(ends: bool, count=60_000, half_m=(6.0, 1.0, 1.2)):
    """Inner faces of a corridor along x around the sensor, with end walls or without."""
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-1, 1, size=(count, 3)) * half_m
    face = rng.choice([2, 3, 4, 5, *([0, 1] if ends else [])], size=count)
    side = half_m * np.ones((count, 3))
    rows = np.arange(count)
    points_m[rows, face // 2] = (side * (2 * (face % 2)[:, None] - 1))[rows, face // 2]
    return points_m + 0.02


def evidence_of(points_m):
    skipmap = build_skipmap(points_m, VOXEL_M, np.zeros(3))
    return build_evidence(skipmap, points_m, np.random.default_rng(0))


@pytest.fixture(scope="module")
def closed():
    return evidence_of(tube(ends=True))


@pytest.fixture(scope="module")
def open_ended():
    return evidence_of(tube(ends=False))


@pytest.mark.parametrize("shift_m", [-0.2, 0.1, 0.25])
def test_end_walls_bring_a_shifted_pose_back(closed, shift_m):
    start = make_transform(np.eye(3), shift_m * ALONG)
    slid = slide(start, ALONG, closed, closed, *CASE)
    assert abs(slid[0, 3]) < 0.25 * VOXEL_M
    np.testing.assert_array_equal(slid[1:], start[1:])
    assert not slides_freely(np.eye(4), ALONG, closed, closed, *CASE)


def test_nothing_holds_a_pose_along_an_open_corridor(open_ended):
    assert slides_freely(np.eye(4), ALONG, open_ended, open_ended, *CASE)
    assert not slides_freely(np.eye(4), ACROSS, open_ended, open_ended, *CASE)
