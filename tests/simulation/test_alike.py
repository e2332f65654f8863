"""What is alike and not the same: specimens share most and differ in a part."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from skipnet.geometry import transform_points
from skipnet.simulation.situations.alike import KINDS, alike
from skipnet.simulation.situations.making import anywhere
from skipnet.simulation.situations.objects import FLIPPED


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_gives_the_same_two_and_they_have_no_right_pose(kind):
    one, again, other = alike(kind, 62_100), alike(kind, 62_100), alike(kind, 62_101)
    np.testing.assert_array_equal(one.source_m, again.source_m)
    np.testing.assert_array_equal(one.target_m, again.target_m)
    assert one.T_target_source is None and min(len(one.source_m), len(one.target_m)) > 5000
    assert one.source_m.shape != other.source_m.shape or (one.source_m != other.source_m).any()


@pytest.mark.parametrize(
    ("kind", "far", "least", "most"),
    [
        ("part, other bosses", 1.0, 0.03, 0.6),
        ("part, one other boss", 1.0, 0.003, 0.3),
        ("bust, another head", 0.05, 0.01, 0.4),
    ],
)
def test_specimens_differ_in_a_part(kind, far, least, most):
    rng = np.random.default_rng(5)
    look = KINDS[kind](rng)
    first_m, second_m = look(rng), look(rng)
    away_m, _ = cKDTree(second_m).query(first_m)
    gaps_m, _ = cKDTree(first_m).query(first_m, k=2)
    beyond = away_m > 3 * np.median(gaps_m[:, 1]) + far
    assert least < beyond.mean() < most


def test_a_mirror_image_is_one_of_the_source_itself():
    kind = "mirror image"
    two = alike(kind, 62_102)
    # The same draws again: the frame comes last.
    rng = np.random.default_rng([62_102, 11, list(KINDS).index(kind)])
    look = KINDS[kind](rng)
    look(rng), look(rng), rng.normal(0, 0.05, two.source_m.shape)
    T = anywhere(rng, float(np.linalg.norm(np.ptp(two.source_m, axis=0))))
    off_m = transform_points(T, two.source_m * FLIPPED) - two.target_m
    assert np.abs(off_m).max() < 0.5


def test_sensors_in_rooms_stand_at_the_origin_of_both_scans():
    for kind in ("room, other furniture", "tank, other fittings"):
        two = alike(kind, 62_103)
        for points_m in (two.source_m, two.target_m):
            nearest_m = np.linalg.norm(points_m, axis=1).min()
            assert nearest_m > 0.3, kind
