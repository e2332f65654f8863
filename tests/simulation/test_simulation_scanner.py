"""Scans against brute-force geometry in float64 and against the statistics that were asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.geometry import transform_points
from skipnet.simulation.scanning.scanner import SCANNERS, find_scanner, scan
from skipnet.simulation.scenes.scenes import FAMILIES, make_scene, place_sensors

WITH_FLAT_SURFACES = [family for family in FAMILIES if family != "terrain"]

IDEAL = replace(SCANNERS["terrestrial"], range_sigma_m=0.0, dropout=0.0)


def first_hits_by_brute_force(scene, origin_m, directions):
    """Moller & Trumbore 1997 for every ray and triangle: range (inf for a miss) and triangle."""
    a, b, c = np.moveaxis(scene.vertices_m[scene.triangles], 1, 0)
    cross = np.cross(directions[:, None], c - a)
    determinant = np.einsum("tk,rtk->rt", b - a, cross)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("tk,rtk->rt", origin_m - a, cross) / determinant
        q = np.cross(origin_m - a, b - a)
        v = directions @ q.T / determinant
        range_m = np.einsum("tk,tk->t", c - a, q) / determinant
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (range_m > 0)
    range_m = np.where(hit, range_m, np.inf)
    return range_m.min(axis=1), range_m.argmin(axis=1)


@pytest.mark.parametrize("family", ["paper_room", "oblique", "doorway", "closed"])
def test_every_beam_stops_at_the_first_surface_on_its_way(family):
    scene = make_scene(family, 7)
    pose = place_sensors(scene, 2, 7)[1]
    one = scan(scene, IDEAL.with_beams(2500), pose, seed=0)
    true_m = one.true_points_m.astype(np.float64)
    range_m = np.linalg.norm(true_m, axis=1)
    directions = true_m / range_m[:, None] @ pose[:3, :3].T
    expected_m, triangle = first_hits_by_brute_force(scene, pose[:3, 3], directions)
    # A beam within float32 of an edge may pass it on the other side: at most one in a thousand.
    agrees = np.abs(expected_m - range_m) < 1e-4
    assert agrees.mean() > 0.999
    assert (scene.surface_of_triangle[triangle] == one.surface_of_point)[agrees].mean() > 0.998


@pytest.mark.parametrize("family", WITH_FLAT_SURFACES)
def test_points_lie_on_the_plane_of_the_surface_they_name(family):
    scene = make_scene(family, 2)
    for pose in place_sensors(scene, 2, 2):
        one = scan(scene, IDEAL.with_beams(20_000), pose, seed=0)
        world_m = transform_points(pose, one.true_points_m.astype(np.float64))
        first_triangle = np.unique(scene.surface_of_triangle, return_index=True)[1]
        triangle = first_triangle[one.surface_of_point]
        normals = scene.triangle_normals[triangle]
        anchors_m = scene.vertices_m[scene.triangles[triangle, 0]]
        offsets_m = np.einsum("ij,ij->i", normals, world_m - anchors_m)
        assert np.abs(offsets_m[~scene.surface_is_curved[one.surface_of_point]]).max() < 2e-5


@pytest.mark.parametrize("family", FAMILIES)
def test_surfaces_show_their_free_side_to_the_sensor(family):
    met_from_behind = met = 0
    for seed in range(3):
        scene = make_scene(family, seed)
        for pose in place_sensors(scene, 2, seed):
            directions = IDEAL.with_beams(30_000).directions()
            hits = scene.raycaster.cast(pose[:3, 3], directions)
            hit = np.isfinite(hits.distances)
            normals = scene.triangle_normals[hits.triangle[hit]]
            met += hit.sum()
            met_from_behind += (np.einsum("ij,ij->i", normals, directions[hit]) >= 0).sum()
    # A beam through an edge, to float32, may be told the edge's far face.
    assert met > 30_000
    assert met_from_behind <= 1


def test_a_closed_room_returns_every_beam_and_windows_swallow_some():
    closed = make_scene("closed", 0)
    model = IDEAL.with_beams(20_000)
    beams = model.channels * model.azimuth_steps
    assert len(scan(closed, model, place_sensors(closed, 1, 0)[0], 0).points_m) == beams
    paper = make_scene("paper_room", 0)
    pose = place_sensors(paper, 1, 0)[0]
    directions = model.directions()
    missed = ~np.isfinite(paper.raycaster.cast(pose[:3, 3], directions).distances)
    # From the centre of a 10 x 10 x 3 m room every lost beam crosses y = -5 or 5 inside the wall.
    way = directions[missed] * (5 / np.abs(directions[missed][:, 1:2]))
    assert 0.005 < missed.mean() < 0.10
    assert np.abs(way[:, 0]).max() < 5.0
    height_m = way[:, 2] + pose[2, 3]
    assert height_m.min() > 0.0
    assert height_m.max() < 0.9 + 1.6


def test_noise_and_dropout_are_what_was_asked_for():
    scene = make_scene("closed", 1)
    pose = place_sensors(scene, 1, 1)[0]
    model = replace(SCANNERS["terrestrial"], range_sigma_m=0.01, dropout=0.1)
    one = scan(scene, model, pose, seed=5)
    beams = model.channels * model.azimuth_steps
    spread = np.sqrt(0.1 * 0.9 / beams)
    assert len(one.points_m) / beams == pytest.approx(0.9, abs=5 * spread)
    true_m, noisy_m = one.true_points_m.astype(np.float64), one.points_m.astype(np.float64)
    along = true_m / np.linalg.norm(true_m, axis=1, keepdims=True)
    error_m = np.einsum("ij,ij->i", noisy_m - true_m, along)
    assert error_m.std() == pytest.approx(0.01, rel=0.01)
    assert error_m.mean() == pytest.approx(0.0, abs=5 * 0.01 / np.sqrt(len(error_m)))
    assert np.abs(noisy_m - true_m - error_m[:, None] * along).max() < 1e-5


def test_presets_have_the_shape_they_promise():
    dome, rings = SCANNERS["terrestrial"], SCANNERS["rings"]
    assert 190_000 <= dome.channels * dome.azimuth_steps <= 230_000
    elevation_deg = np.rad2deg(np.arcsin(dome.directions()[:, 2]))
    assert elevation_deg.min() == pytest.approx(-60)
    assert elevation_deg.max() == pytest.approx(90)
    assert (rings.channels, rings.azimuth_steps) == (16, 1800)
    elevation_deg = np.rad2deg(np.arcsin(rings.directions()[:, 2]))
    np.testing.assert_allclose(np.unique(elevation_deg.round(6)), np.linspace(-15, 15, 16))


@pytest.mark.parametrize(("name", "beams"), [("terrestrial", 50_000), ("rings", 8_000)])
def test_with_beams_keeps_the_kind_of_scanner(name, beams):
    model = SCANNERS[name].with_beams(beams)
    assert model.channels * model.azimuth_steps == pytest.approx(beams, rel=0.02)
    if model.fixed_channels:
        assert model.channels == SCANNERS[name].channels
    else:
        step_rad = (model.highest_rad - model.lowest_rad) / model.channels
        assert step_rad == pytest.approx(2 * np.pi / model.azimuth_steps, rel=0.02)


@pytest.mark.parametrize("name", SCANNERS)
def test_clouds_are_dense_near_and_sparse_far(name):
    # An empty corridor along x shows the same area in every metre of its length.
    scene = make_scene("corridor", 0)
    points_m = scan(scene, SCANNERS[name], place_sensors(scene, 1, 0)[0], 0).points_m
    counts = np.histogram(np.abs(points_m[:, 0]), bins=[2, 10, 18, 26])[0]
    assert counts[0] > 2 * counts[1] > 2 * counts[2] > 0


def test_range_limits_hold():
    scene = make_scene("corridor", 0)
    pose = place_sensors(scene, 1, 0)[0]
    model = replace(IDEAL, min_range_m=1.0, max_range_m=12.0)
    range_m = np.linalg.norm(scan(scene, model, pose, 0).points_m, axis=1)
    assert 0.999 < range_m.min() < 1.1
    assert 11.0 < range_m.max() < 12.001
    ends = np.abs(scene.triangle_normals[:, 0]) > 0.9
    seen = scan(scene, SCANNERS["terrestrial"], pose, 0).surface_of_point
    assert not np.isin(seen, scene.surface_of_triangle[ends]).any(), "its ends are out of range"


def test_same_seed_same_bits_other_seed_other_noise():
    scene = make_scene("paper_room", 0)
    pose = place_sensors(scene, 1, 0)[0]
    model = SCANNERS["terrestrial"].with_beams(10_000)
    first, again, other = (scan(scene, model, pose, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.points_m, again.points_m)
    np.testing.assert_array_equal(first.surface_of_point, again.surface_of_point)
    assert not np.array_equal(first.points_m, other.points_m)


def test_noise_of_a_beam_does_not_depend_on_what_is_lost():
    scene = make_scene("closed", 0)
    pose = place_sensors(scene, 1, 0)[0]
    model = replace(SCANNERS["terrestrial"].with_beams(5_000), dropout=0.0)
    complete = scan(scene, model, pose, 3).points_m
    thinned = scan(scene, replace(model, dropout=0.3), pose, 3).points_m
    assert 0.6 < len(thinned) / len(complete) < 0.8
    assert {row.tobytes() for row in thinned} <= {row.tobytes() for row in complete}


def test_unknown_scanner_and_impossible_values_say_what_is_expected():
    with pytest.raises(ValueError, match=r"'ring'.*did you mean 'rings'.*terrestrial"):
        find_scanner("ring")
    with pytest.raises(ValueError, match="points is 0"):
        SCANNERS["rings"].with_beams(0)
    for bad in ({"dropout": 1.0}, {"range_sigma_m": -0.1}, {"max_range_m": 0.1}, {"channels": 0}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            replace(SCANNERS["rings"], **bad)
