"""Finding out whether a scan was taken from its origin: simulated scans know."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import transform_points
from skipnet.scans.viewpoint import (
    MAX_HIDDEN_SHARE,
    MIN_FALLOFF,
    density_falloff,
    find_viewpoint,
    hidden_share,
)
from skipnet.simulation.scanning.figures import turn_figure
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scenes.scenes import FAMILIES
from skipnet.skipmap.skipmap import build_skipmap

ORIGIN_M = np.zeros(3)


@pytest.mark.parametrize("scanner", ["terrestrial", "rings"])
@pytest.mark.parametrize("family", FAMILIES)
def test_the_true_viewpoint_of_a_single_scan_is_accepted(family, scanner):
    scan_m = simulate_pair(family, 1, scanner=scanner, points=40_000).pair.source_m
    skipmap = build_skipmap(scan_m.astype(float), 0.2)
    np.testing.assert_array_equal(find_viewpoint(skipmap, ORIGIN_M), ORIGIN_M)


@pytest.mark.parametrize("family", ["paper_room", "oblique", "doorway"])
def test_fused_scans_and_wrong_places_hide_more_than_the_true_one(family):
    pair = simulate_pair(family, 2, points=60_000).pair
    moved_m = transform_points(pair.T_target_source, pair.source_m.astype(float))
    fused = build_skipmap(np.concatenate([moved_m, pair.target_m]), 0.15)
    single = build_skipmap(pair.target_m.astype(float), 0.15)
    true_share = hidden_share(single, ORIGIN_M)
    assert true_share < 0.1 * MAX_HIDDEN_SHARE
    assert hidden_share(fused, ORIGIN_M) > true_share
    for place_m in ([0.0, 0, 40.0], [-35.0, 20.0, 5.0], [300_000.0, 5_000_000.0, 200.0]):
        assert find_viewpoint(single, np.array(place_m)) is None


def test_what_a_panel_hides_counts_and_what_lies_beside_or_before_it_does_not():
    # A panel at x = 2 before a wall at x = 4: from the origin it hides the middle of the wall.
    rng = np.random.default_rng(0)
    wall_m = rng.uniform([4.03, -5, -5], [4.03, 5, 5], size=(100_000, 3))
    shares = []
    for half_m in (0.5, 1.0, 2.0):
        panel_m = rng.uniform([2.03, -half_m, -half_m], [2.03, half_m, half_m], size=(20_000, 3))
        skipmap = build_skipmap(np.concatenate([panel_m, wall_m]), 0.1)
        hidden = np.abs(skipmap.centroids_m[:, 1:]).max(axis=1) < 2 * half_m
        hidden &= skipmap.centroids_m[:, 0] > 3
        shares.append(hidden_share(skipmap, ORIGIN_M))
        assert shares[-1] == pytest.approx(hidden.mean(), rel=0.3)
        # From between the two nothing is hidden.
        assert hidden_share(skipmap, np.array([3.0, 0, 0])) == 0
    assert shares[0] < shares[1] < shares[2]


def test_a_slanted_surface_does_not_hide_itself():
    rng = np.random.default_rng(0)
    floor_m = rng.uniform([-6, -6, -1.53], [6, 6, -1.53], size=(60_000, 3))
    assert hidden_share(build_skipmap(floor_m, 0.2), ORIGIN_M) == 0


def test_the_sign_of_the_normals_does_not_matter():
    pair = simulate_pair("paper_room", 3, points=30_000).pair
    skipmap = build_skipmap(pair.target_m.astype(float), 0.2)
    for viewpoint_m in (ORIGIN_M, np.array([0.0, 0, 30.0])):
        shares = [
            hidden_share(skipmap.seen_from(np.array(seen_from)), viewpoint_m)
            for seen_from in ([0.0, 0, 0], [0, 0, 99.0])
        ]
        assert shares[0] == shares[1]


@pytest.mark.parametrize("seed", range(6))
def test_an_object_was_not_scanned_from_the_origin_inside_it(seed):
    camera_m, _ = turn_figure(seed).clouds_m(0.0)
    middle_m = camera_m.mean(axis=0) * (1 + 0.03 / np.linalg.norm(camera_m.mean(axis=0)))
    skipmap = build_skipmap(camera_m.astype(float), 0.002)
    np.testing.assert_array_equal(find_viewpoint(skipmap, ORIGIN_M), ORIGIN_M)
    assert find_viewpoint(skipmap, middle_m) is None


def test_density_falls_off_about_the_sensor_and_not_about_other_places():
    # A wall at x = 3, seen in even steps of angle: a constant number of points per solid angle.
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400_000, 3))
    ways = ways[ways[:, 0] > 0.4 * np.linalg.norm(ways, axis=1)]
    wall_m = 3.03 * ways / ways[:, :1]
    skipmap = build_skipmap(wall_m, 0.2)
    assert density_falloff(skipmap, ORIGIN_M) > 0.9
    assert density_falloff(skipmap, np.array([3.0, 9, 0])) < MIN_FALLOFF
    # What is spread evenly over its surface says nothing.
    even_m = rng.uniform([3.03, -6, -6], [3.03, 6, 6], size=(100_000, 3))
    assert abs(density_falloff(build_skipmap(even_m, 0.2), ORIGIN_M)) < MIN_FALLOFF
