"""Points far from all others are found, whatever the frame, and never in scans without them."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

import skipnet
from skipnet.clouds import strays
from skipnet.clouds.strays import find_strays
from skipnet.geometry import make_transform, pose_error, random_rotation, transform_points
from skipnet.simulation.scanning.pairs import simulate_pair


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("oblique", 71, points=60_000).pair


def cluttered(points_m, widths, seed=0):
    """The points and 5 % more, anywhere in a space so many times as wide."""
    rng = np.random.default_rng(seed)
    reach_m = widths * np.linalg.norm(np.ptp(points_m, axis=0))
    return np.vstack([points_m, rng.uniform(-reach_m, reach_m, (len(points_m) // 20, 3))])


@pytest.mark.parametrize("family", ["paper_room", "facade", "terrain", "kitchen"])
@pytest.mark.parametrize("scanner", ["terrestrial", "rings"])
def test_scans_without_strays_lose_nothing(family, scanner):
    points_m = simulate_pair(family, 72, scanner, points=60_000).pair.source_m
    assert find_strays(points_m) is None


def test_one_point_at_a_great_distance_is_found(pair):
    found = find_strays(np.vstack([[[1e6, 2e5, 0.0]], pair.source_m]))
    assert found[0] and found.sum() == 1


def test_rows_of_zeros_among_map_coordinates_are_found(pair):
    zeros, offset_m = np.zeros((50, 3)), [500_000.0, 5_000_000.0, 100.0]
    found = find_strays(np.vstack([pair.source_m + offset_m, zeros]))
    assert found[-50:].all() and found.sum() == 50


@pytest.mark.parametrize("widths", [1.5, 5])
def test_what_is_found_has_no_neighbours_and_is_the_clutter(pair, widths):
    points_m = cluttered(pair.source_m, widths)
    found = find_strays(points_m)
    _, spread_m, _ = strays._middle_and_spread(points_m)
    near_m = strays.NEAR_SPREADS * spread_m
    around = cKDTree(points_m).query_ball_point(points_m, near_m, return_length=True)
    np.testing.assert_array_equal(found, around <= strays.NEIGHBOURS)
    assert found[len(pair.source_m) :].mean() > 0.98 and not found[: len(pair.source_m)].any()


def test_the_frame_does_not_matter(pair):
    rng = np.random.default_rng(3)
    points_m = cluttered(pair.source_m, 2)
    turned_m = transform_points(make_transform(random_rotation(rng), [5.0, 9, 2]), points_m)
    found = find_strays(points_m)
    # The spread is measured about a median of coordinates, which turns along to a few per cent.
    assert (found != find_strays(turned_m)).mean() < 1e-3


def test_what_a_cloud_consists_of_are_no_strays():
    rng = np.random.default_rng(0)
    assert find_strays(rng.uniform(-1, 1, (12, 3))) is None
    assert find_strays(np.zeros((9, 3))) is None


@pytest.mark.parametrize("widths", [1.5, 5])
def test_clutter_and_a_stray_leave_the_pose_and_are_counted(pair, widths):
    source_m = np.vstack([cluttered(pair.source_m, widths), [[1e6, 0, 0]]])
    result = skipnet.register(source_m, pair.target_m)
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    assert result.status == "registered"
    assert np.rad2deg(rotation_rad) < 0.05 and translation_m < 0.01
    left_out = len(source_m) - len(pair.source_m)
    assert 0.98 * left_out < result.details["source_strays"] <= left_out
    assert "points far from all others were left out" in result.reason
