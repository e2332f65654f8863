"""Finding out from which side a thing was seen: simulated scanners know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import skipnet
from skipnet.geometry import invert, make_transform, random_rotation, transform_points
from skipnet.registration.judging.judge import Judge
from skipnet.scans.afar import MIN_CONVEXITY, side_seen
from skipnet.scans.describing import describe, restored
from skipnet.scans.record import read_record, write_record
from skipnet.simulation.scanning.figures import figure, turn_figure, turn_sculpture
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scenes.raycasting import Raycaster
from skipnet.simulation.scenes.shapes import join, moved, sphere
from skipnet.skipmap.skipmap import build_skipmap

MIDDLE_M = np.zeros(3)
"""Of things: what their scanners give as origins."""
UNKNOWN_M = np.array([1e6, 0, 0])
"""Explains nothing."""


def maps_of(points_m, voxel_size_m):
    return [build_skipmap(points_m, size_m) for size_m in (voxel_size_m, voxel_size_m / 2)]


def in_its_own_frame(points_m, rng):
    """A thing's points about its own middle, turned at random, and the motion there."""
    T_own_camera = make_transform(random_rotation(rng), np.zeros(3))
    T_own_camera[:3, 3] = -T_own_camera[:3, :3] @ (points_m.mean(axis=0) + rng.normal(0, 0.01, 3))
    return transform_points(T_own_camera, points_m), T_own_camera


@pytest.mark.parametrize("turn", [turn_figure, turn_sculpture])
@pytest.mark.parametrize("seed", [501, 502, 507])
def test_the_side_of_a_figure_that_faced_the_scanner_is_found_in_its_own_frame(turn, seed):
    points_m, T_own_camera = in_its_own_frame(
        turn(seed).clouds_m(0.5)[0], np.random.default_rng(seed)
    )
    place_m = side_seen(*maps_of(points_m, 0.0025), MIDDLE_M)
    ways = np.array([place_m, T_own_camera[:3, 3]]) - points_m.mean(axis=0)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    assert ways[0] @ ways[1] > np.cos(np.deg2rad(20))


@pytest.mark.parametrize("family", ["paper_room", "oblique", "terrain", "kitchen", "clutter"])
def test_a_scan_from_within_shows_no_side_of_a_thing(family):
    points_m = simulate_pair(family, 5, points=40_000).pair.source_m.astype(float)
    assert side_seen(*maps_of(points_m, 0.2), UNKNOWN_M) is None


def test_a_ball_seen_all_round_has_no_side_that_was_seen():
    rng = np.random.default_rng(1)
    ball_m = rng.normal(size=(40_000, 3))
    ball_m *= 0.1 / np.linalg.norm(ball_m, axis=1)[:, None]
    assert side_seen(*maps_of(ball_m, 0.01), UNKNOWN_M) is None


def half_ball_seen_from_above(bulge):
    """What a parallel scanner sees of a half ball from +z: as many points wherever it looks."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-0.1, 0.1, size=(2, 60_000))
    inside = x**2 + y**2 < 0.098**2
    height_m = bulge * np.sqrt(0.01 - x[inside] ** 2 - y[inside] ** 2)
    return np.column_stack([x[inside], y[inside], height_m])


def test_a_dome_was_seen_from_above_and_places_that_explain_its_density_are_kept():
    maps = maps_of(half_ball_seen_from_above(1.0), 0.008)
    place_m = side_seen(*maps, UNKNOWN_M)
    assert place_m[2] > 0.9 * np.linalg.norm(place_m)
    # A parallel scanner's place is any place afar.
    assert side_seen(*maps, 100 * place_m) is None


def test_of_a_bowl_with_things_in_it_no_side_is_told_rather_than_its_back(monkeypatch):
    rng, ball = np.random.default_rng(1), sphere(1.0, 200)[0]
    unit = ball.vertices_m - [0, 0, 1]
    parts = [replace(ball, vertices_m=np.where(unit[:, :1] < 0, unit * [-0.77, 0.9, 0.9], unit))]
    for _ in range(5):
        at = make_transform(random_rotation(rng), np.array([0.6, *rng.uniform(-0.35, 0.35, 2)]))
        parts += moved(sphere(0.2), at)
    whole = join([replace(part, vertices_m=0.07 * part.vertices_m) for part in parts])
    bowl = Raycaster(whole.vertices_m, whole.triangles)
    table = replace(turn_figure(1), caster=bowl, axis=np.array([0.0, 0, 1]))
    points_m, T_own_camera = in_its_own_frame(table.clouds_m(0.0)[0], np.random.default_rng(1))
    maps = maps_of(points_m, 0.0025)
    assert side_seen(*maps, UNKNOWN_M) is None
    # By its shape alone it is a dome, seen from below.
    monkeypatch.setattr("skipnet.scans.afar.MAX_BEHIND", 1.0)
    assert side_seen(*maps, UNKNOWN_M) @ T_own_camera[:3, 3] < 0


def test_sides_that_are_only_likely_are_not_known():
    points_m, _ = in_its_own_frame(turn_figure(505).clouds_m(0.5)[0], np.random.default_rng(5))
    (scan,) = describe([points_m], ["auto"])
    likely = replace(scan.evidence, sides=0.4 * scan.evidence.sides)
    assert Judge(scan.evidence, scan.evidence, 100, 10.0).are_sided
    assert not Judge(scan.evidence, likely, 100, 10.0).are_sided


def test_gentle_waves_tell_no_side():
    points_m = half_ball_seen_from_above(1.0)
    points_m[:, 2] = 0.02 * np.sin(60 * points_m[:, 0])
    assert MIN_CONVEXITY > 0.1
    assert side_seen(*maps_of(points_m, 0.008), UNKNOWN_M) is None


def test_an_origin_within_a_figure_is_not_its_scanners_place(tmp_path):
    points_m, T_own_camera = in_its_own_frame(
        turn_figure(505).clouds_m(0.5)[0], np.random.default_rng(5)
    )
    scan, unknown = describe([points_m, points_m], ["auto", None])
    assert scan.record.range_image is None and scan.record.trust == 0
    camera_m = transform_points(invert(scan.T_given_own) @ T_own_camera, np.zeros((1, 3)))[0]
    towards = np.einsum("vi,vi->v", scan.skipmap.normals, camera_m - scan.skipmap.centroids_m)
    assert (towards > 0).mean() > 0.95
    assert scan.evidence.sides.mean() > 0.8 and scan.evidence.trust == 0
    # Who says that nobody knows is believed.
    assert unknown.record.side is None and not unknown.evidence.sides.any()

    write_record(scan.record, tmp_path / "scan.npz")
    again = restored(read_record(tmp_path / "scan.npz"), scan.network)
    np.testing.assert_array_equal(again.skipmap.normals, scan.skipmap.normals)
    np.testing.assert_array_equal(again.evidence.sides, scan.evidence.sides)


def test_figures_in_their_own_frames_are_registered_by_their_sides():
    table, rng = turn_sculpture(506), np.random.default_rng(6)
    (source_m, T_source), (target_m, T_target) = (
        in_its_own_frame(cloud_m, rng) for cloud_m in table.clouds_m(np.deg2rad(50))
    )
    truth = T_target @ table.T_target_source(np.deg2rad(50)) @ invert(T_source)
    found = skipnet.register(source_m, target_m)
    assert found.status == "registered" and found.findings.are_sided
    to_camera = T_source[:3, 3] - source_m.mean(axis=0)
    cosine = np.array(found.details["source_side"]) @ to_camera / np.linalg.norm(to_camera)
    assert cosine > np.cos(np.deg2rad(20)) and found.details["source_viewpoint_m"] is None
    assert found.findings.blind == 1.0
    moved_m = transform_points(found.T_target_source, source_m)
    off_m = np.linalg.norm(moved_m - transform_points(truth, source_m), axis=1)
    assert off_m.max() < 0.002


@pytest.mark.parametrize("seed", [519, 520])
def test_a_limb_before_the_side_that_the_other_scan_shows_belongs_to_another_figure(seed):
    turn_rad, rng, table = np.deg2rad(35), np.random.default_rng(seed), turn_figure(seed)
    fewer = join(figure(np.random.default_rng([seed, 0]))[:-1])
    other = replace(table, caster=Raycaster(fewer.vertices_m, fewer.triangles))
    source_m, _ = in_its_own_frame(table.clouds_m(turn_rad)[0], rng)
    same_m, _ = in_its_own_frame(table.clouds_m(turn_rad)[1], rng)
    other_m, T_own_camera = in_its_own_frame(other.clouds_m(turn_rad)[1], rng)
    found = skipnet.register(source_m, same_m)
    assert found.status == "registered" and found.details["stands_before_share"] == 0
    found = skipnet.register(source_m, other_m)
    assert found.status == "ambiguous" and "stands before what the other one shows" in found.reason
    (limb_m,) = np.array(found.details["stands_before_at_m"])
    # Where the other figure's camera looks past, some centimetres before what it sees.
    from_camera_m = np.array([limb_m, *other_m]) - T_own_camera[:3, 3]
    range_m = np.linalg.norm(from_camera_m, axis=1)
    beside = from_camera_m[1:] @ from_camera_m[0] / range_m[1:] / range_m[0] > 0.9999
    assert range_m[0] < range_m[1:][beside].min() - 0.004
