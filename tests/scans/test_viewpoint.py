"""Finding out whether a scan was taken from its origin: simulated scans know."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, transform_points
from skipnet.scans.describing import describe
from skipnet.scans.scan import MIN_TRUST
from skipnet.scans.viewpoint import FALLOFF, HIDDEN_SHARE, density_falloff, hidden_share, sides
from skipnet.scans.viewpoint import trust_in as trust_in_maps
from skipnet.simulation.scanning.figures import turn_figure
from skipnet.simulation.scanning.pairs import simulate_pair, simulate_scans
from skipnet.simulation.scanning.scanner import SCANNERS, scan
from skipnet.simulation.scenes.scenes import FAMILIES
from skipnet.skipmap.skipmap import build_skipmap

ORIGIN_M = np.zeros(3)


def trust_in(points_m, voxel_size_m, place_m, is_given=False):
    points_m = np.asarray(points_m, dtype=np.float64)
    maps = (build_skipmap(points_m, size_m) for size_m in (voxel_size_m, voxel_size_m / 2))
    return trust_in_maps(*maps, np.asarray(place_m, dtype=np.float64), is_given)


@pytest.mark.parametrize("scanner", ["terrestrial", "rings"])
@pytest.mark.parametrize("family", FAMILIES)
def test_the_true_viewpoint_of_a_single_scan_is_believed(family, scanner):
    scan_m = simulate_pair(family, 1, scanner=scanner, points=40_000).pair.source_m
    assert trust_in(scan_m, 0.2, ORIGIN_M) > 0.95


@pytest.mark.parametrize("family", ["paper_room", "oblique", "doorway"])
def test_places_outside_are_not_believed_whoever_gives_them(family):
    pair = simulate_pair(family, 2, points=60_000).pair
    moved_m = transform_points(pair.T_target_source, pair.source_m.astype(float))
    fused = build_skipmap(np.concatenate([moved_m, pair.target_m]), 0.15)
    single = build_skipmap(pair.target_m.astype(float), 0.15)
    assert hidden_share(fused, ORIGIN_M) > hidden_share(single, ORIGIN_M)
    assert hidden_share(single, ORIGIN_M) < 0.1 * HIDDEN_SHARE[0]
    for place_m in ([0.0, 0, 40.0], [-35.0, 20.0, 5.0], [300_000.0, 5_000_000.0, 200.0]):
        for is_given in (False, True):
            assert trust_in(pair.target_m, 0.15, place_m, is_given) < MIN_TRUST


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_first_of_a_moving_cameras_places_is_believed(seed):
    scans, scene = simulate_scans("kitchen", seed, 1, points=200_000)
    first = scans[0].T_world_sensor
    fragment_m = []
    for step in range(5):
        # Half a metre on the way, looking to one side, as far as a depth camera reaches.
        T = first @ make_transform(np.eye(3), np.array([0.1 * step, 0.05 * step, 0.02 * step]))
        seen_m = scan(scene, SCANNERS["terrestrial"].with_beams(200_000), T, step).points_m
        seen_m = seen_m[(seen_m[:, 0] > 0.7 * np.linalg.norm(seen_m, axis=1))]
        fragment_m.append(transform_points(np.linalg.inv(first) @ T, seen_m.astype(float)))
    fragment_m = np.concatenate(fragment_m)
    assert trust_in(fragment_m, 0.05, ORIGIN_M) > 0.9
    # Its density says less and less when it is thinned to one point a voxel, and need not.
    cells = np.unique(np.floor(fragment_m / 0.02).astype(np.int64), axis=0, return_index=True)[1]
    assert trust_in(fragment_m[cells], 0.05, ORIGIN_M) > MIN_TRUST


@pytest.mark.parametrize("family", ["paper_room", "oblique", "kitchen"])
def test_the_corner_of_a_map_that_nobody_stood_at_is_not_believed(family):
    scans, _ = simulate_scans(family, 21, 6, points=60_000)
    map_m = np.concatenate([transform_points(s.T_world_sensor, s.points_m) for s in scans])
    corner_m = map_m.min(axis=0)
    assert trust_in(map_m, 0.2, corner_m) < 0.1
    (described,) = describe([map_m - corner_m], ["auto"])
    assert described.viewpoint_m is None and described.record.trust < 0.1


def test_a_surface_seen_edge_on_has_no_known_side():
    rng = np.random.default_rng(0)
    floor_m = rng.uniform([-3, -3, 0], [3, 3, 0], size=(60_000, 3))
    wall_m = rng.uniform([3, -3, 0], [3, 3, 3], size=(60_000, 3))
    skipmap = build_skipmap(np.concatenate([floor_m, wall_m]) + 0.03, 0.2)
    height_m = np.abs(skipmap.centroids_m[:, 2] - 0.03)
    on_floor = (height_m < 0.01) & (np.abs(skipmap.centroids_m[:, 0]) < 2.5)
    on_wall = (height_m > 0.5) & (np.abs(skipmap.centroids_m[:, 1]) < 2.5)
    low = sides(skipmap, np.array([0.03, 0.03, 0.03]))
    high = sides(skipmap, np.array([0.03, 0.03, 1.5]))
    np.testing.assert_array_equal(low[on_floor], 0)
    np.testing.assert_array_equal(high[on_floor], 1)
    np.testing.assert_array_equal(low[on_wall], 1)
    turned = sides(skipmap.seen_from(np.array([0, 0, -50.0])), np.array([0.03, 0.03, 1.5]))
    np.testing.assert_array_equal(turned, high)


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
    assert trust_in(camera_m, 0.002, ORIGIN_M) > 0.95
    assert trust_in(camera_m, 0.002, middle_m) < MIN_TRUST


def test_density_falls_off_about_the_sensor_and_not_about_other_places():
    # A wall at x = 3, seen in even steps of angle: a constant number of points per solid angle.
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400_000, 3))
    ways = ways[ways[:, 0] > 0.4 * np.linalg.norm(ways, axis=1)]
    wall_m = 3.03 * ways / ways[:, :1]
    skipmap = build_skipmap(wall_m, 0.2)
    assert density_falloff(skipmap, ORIGIN_M) > 0.9
    assert density_falloff(skipmap, np.array([3.0, 9, 0])) < FALLOFF[1]
    # What is spread evenly over its surface says nothing.
    even_m = rng.uniform([3.03, -6, -6], [3.03, 6, 6], size=(100_000, 3))
    assert abs(density_falloff(build_skipmap(even_m, 0.2), ORIGIN_M)) < FALLOFF[1]
