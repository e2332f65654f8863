"""Pairs with a chosen overlap: they have it, and their truth holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from skipnet.benchmark.datasets.overlapping import KINDS, goal_overlap, make_pair, overlapping_pairs
from skipnet.geometry import transform_points
from skipnet.simulation.scanning.degrading import in_cone
from skipnet.simulation.scanning.figures import HEIGHT_M, turn_figure
from skipnet.simulation.scanning.views import DEVICES, look_around
from skipnet.simulation.seeds import TUNING

KIND_OF = {kind.name: kind for kind in KINDS}


def gaps(source_m, target_m, T_target_source):
    """(N,) how far every source point is from the target under a pose."""
    return cKDTree(target_m).query(transform_points(T_target_source, source_m))[0]


def test_six_of_ten_pairs_have_ten_to_thirty_per_cent():
    goals = np.array([goal_overlap(share) for share in np.linspace(0.0005, 0.9995, 1000)])
    assert goals.min() >= 0.05
    assert goals.max() <= 0.6
    assert ((goals >= 0.1) & (goals < 0.3)).mean() == pytest.approx(0.6, abs=0.005)
    assert (np.diff(goals) > 0).all()


@pytest.mark.parametrize(
    ("name", "goal", "reach_m"),
    [("kitchen, camera", 0.25, 0.1), ("kitchen, fused", 0.25, 0.1), ("figure, camera", 0.3, 0.002)],
)
def test_a_pair_has_the_overlap_and_the_truth_it_says(name, goal, reach_m):
    pair = make_pair(KIND_OF[name], TUNING.take(5), goal, "it")
    near = (gaps(pair.source_m, pair.target_m, pair.T_target_source) < reach_m).mean()
    assert near == pytest.approx(goal, abs=0.15)  # of points, where the goal is one of voxels
    wrong = pair.T_target_source.copy()
    wrong[:3, 3] += 3 * reach_m
    assert (gaps(pair.source_m, pair.target_m, wrong) < reach_m / 5).mean() < near / 2


def test_the_same_seed_gives_the_same_bits():
    one, again = (overlapping_pairs(1, 7).load(len(KINDS) - 1) for _ in range(2))
    np.testing.assert_array_equal(one.source_m, again.source_m)
    np.testing.assert_array_equal(one.target_m, again.target_m)


def test_every_kind_has_its_pairs():
    pairs = overlapping_pairs(2, 40)
    assert len(pairs) == 2 * len(KINDS)
    assert pairs.names[0] == "oblique, dome_120040"
    assert pairs.names[len(KINDS)] == "oblique, dome_120041"


def test_no_pairs_are_refused():
    with pytest.raises(ValueError, match="pairs=0"):
        overlapping_pairs(0)


def test_an_overlap_that_no_scene_has_is_refused():
    with pytest.raises(ValueError, match="take another seed"):
        make_pair(KIND_OF["figure, camera"], [0], 1.5, "it")


def test_an_unknown_device_is_refused():
    with pytest.raises(ValueError, match="unknown device 'camra'; did you mean 'camera'"):
        look_around("kitchen", 0, "camra")


def test_views_share_less_the_farther_they_turn():
    views = look_around("kitchen", 1, "camera")
    shares = []
    for turn_rad in (0.2, 0.8, 1.6):
        source_m, target_m = views.clouds_m(turn_rad)
        shares.append((gaps(source_m, target_m, views.T_target_source) < 0.1).mean())
    assert shares[0] > shares[1] > shares[2]


def test_a_view_is_what_its_cone_holds():
    views = look_around("kitchen", 1, "camera")
    low_rad, high_rad = DEVICES["camera"].half_angle_rad
    _, target_m = views.clouds_m(0.0)
    assert low_rad <= views.half_angle_rad <= high_rad
    ways = target_m / np.linalg.norm(target_m, axis=1, keepdims=True)
    # The view's axis passes through a beam, which may miss the aim by the scanner's step.
    assert np.arccos(ways @ views.ahead).max() < views.half_angle_rad + 0.02
    points_m = np.array([[1.0, 0.99, 0], [1.0, 1.01, 0], [-1.0, 0, 0]])
    assert in_cone(points_m, np.array([2.0, 0, 0]), np.pi / 4).tolist() == [True, False, False]


def test_a_figure_fits_into_its_height_and_the_camera_sees_one_side():
    table = turn_figure(3)
    source_m, target_m = table.clouds_m(np.deg2rad(40))
    for cloud_m in (source_m, target_m):
        extent_m = np.ptp(cloud_m, axis=0)
        assert 0.3 * HEIGHT_M < extent_m.max() < 2 * HEIGHT_M
        assert 0.3 < np.linalg.norm(cloud_m.mean(axis=0)) < 0.6
    near = gaps(source_m, target_m, table.T_target_source(np.deg2rad(40))) < 0.002
    assert 0.4 < near.mean() < 0.95
