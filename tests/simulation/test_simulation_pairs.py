"""Simulated pairs: the true transform holds, overlap means what it says, bad names are refused."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import transform_points
from skipnet.simulation.scanning.pairs import simulate_pair, simulate_scans
from skipnet.simulation.scenes.scenes import FAMILIES

WITH_FLAT_SURFACES = [family for family in FAMILIES if family != "terrain"]


@pytest.mark.parametrize("rotation", ["yaw", "any"])
@pytest.mark.parametrize("family", WITH_FLAT_SURFACES)
def test_true_transform_lays_source_surfaces_on_target_surfaces(family, rotation):
    simulated = simulate_pair(family, 3, rotation=rotation, points=20_000)
    pair, source, target = simulated.pair, simulated.source, simulated.target
    moved_m = transform_points(pair.T_target_source, source.true_points_m.astype(np.float64))
    ids, counts = np.unique(target.surface_of_point, return_counts=True)
    checked = 0
    for surface in ids[counts >= 30]:
        mine = moved_m[source.surface_of_point == surface]
        theirs = target.true_points_m[target.surface_of_point == surface].astype(np.float64)
        if simulated.scene.surface_is_curved[surface] or len(mine) < 30:
            continue
        centre_m = theirs.mean(axis=0)
        extents, axes = np.linalg.svd(theirs - centre_m, full_matrices=False)[1:]
        if extents[1] < 0.5:
            continue  # seen as a line: its plane is not determined
        # The plane comes from the target's points alone; 30 m away a float32 angle weighs most.
        assert np.abs((mine - centre_m) @ axes[2]).max() < 1e-3
        checked += 1
    assert checked >= 4


def test_pair_says_who_is_who_and_where_the_sensors_are():
    simulated = simulate_pair("paper_room", 5, points=5_000)
    pair = simulated.pair
    assert (pair.name, pair.set_name) == ("paper_room_0005", "paper_room")
    np.testing.assert_array_equal(pair.source_viewpoint_m, np.zeros(3))
    np.testing.assert_array_equal(pair.target_viewpoint_m, np.zeros(3))
    assert np.rad2deg(pair.success_rotation_rad) == pytest.approx(0.5)
    assert pair.success_translation_m == pytest.approx(0.03)
    assert pair.source_m.dtype == pair.target_m.dtype == np.float32
    # The paper's first scan, from the centre, keeps the room's axes and is the target.
    np.testing.assert_allclose(simulated.target.T_world_sensor[:3, :3], np.eye(3))
    np.testing.assert_allclose(simulated.target.T_world_sensor[:2, 3], 0.0)


def test_yaw_turns_about_the_vertical_and_any_turns_every_axis():
    yaw = np.stack([simulate_pair("closed", s, points=100).T_target_source for s in range(24)])
    np.testing.assert_allclose(yaw[:, 2, 2], 1.0)
    quadrant = np.unique((np.sign(yaw[:, 0, 0]), np.sign(yaw[:, 1, 0])), axis=1)
    assert quadrant.shape[1] == 4, "24 yaws leave no quadrant out"
    free = [simulate_pair("closed", s, rotation="any", points=100) for s in range(12)]
    tilts = np.array([p.T_target_source[2, 2] for p in free])
    assert tilts.min() < -0.3
    assert tilts.max() > 0.3
    # Turned frames, same scanner: it stood upright, so its blind cone still points down.
    for p in free:
        world_m = transform_points(p.source.T_world_sensor, p.source.points_m)
        way_m = world_m - p.source.T_world_sensor[:3, 3]
        elevation_deg = np.rad2deg(np.arcsin(way_m[:, 2] / np.linalg.norm(way_m, axis=1)))
        assert elevation_deg.min() > -60.1


@pytest.mark.parametrize("family", ["paper_room", "doorway"])
def test_overlap_is_the_share_that_the_other_scan_covers(family):
    from scipy.spatial import cKDTree

    simulated = simulate_pair(family, 2, points=60_000)
    moved_m = transform_points(simulated.T_target_source, simulated.source.true_points_m)
    # The surface as a fourth coordinate keeps the two sides of the shared wall apart.
    source, target = (
        np.column_stack([points_m, 10.0 * one.surface_of_point])
        for points_m, one in (
            (moved_m, simulated.source),
            (simulated.target.true_points_m, simulated.target),
        )
    )
    nearest_m = cKDTree(target).query(source, distance_upper_bound=0.15)[0]
    covered = np.isfinite(nearest_m).mean()
    # The blind cone below the target and the rims of shadows count for one and not for the other.
    assert simulated.overlap == pytest.approx(covered, abs=0.08)
    assert simulated.pair.overlap == simulated.overlap


def test_doorway_sensors_stand_in_different_rooms_and_share_little():
    for seed in range(6):
        simulated = simulate_pair("doorway", seed, points=5_000)
        assert simulated.target.T_world_sensor[0, 3] < 0 < simulated.source.T_world_sensor[0, 3]
        assert 0.05 < simulated.overlap < 0.75
        target = simulated.target
        behind_wall = transform_points(target.T_world_sensor, target.points_m)[:, 0] > 0.3
        assert 0.005 < behind_wall.mean() < 0.4, "some beams pass the door, the wall stops most"


def test_same_seed_same_bits_whatever_else_was_asked():
    first, again = (simulate_pair("oblique", 4, "rings") for _ in range(2))
    np.testing.assert_array_equal(first.pair.source_m, again.pair.source_m)
    np.testing.assert_array_equal(first.T_target_source, again.T_target_source)
    scans, _ = simulate_scans("oblique", 4, 2, "rings")
    np.testing.assert_array_equal(scans[0].points_m, first.target.points_m)


def test_many_scans_stand_in_many_places():
    scans, _ = simulate_scans("closed", 0, 5, points=1_000)
    places_m = np.stack([one.T_world_sensor[:3, 3] for one in scans])
    gaps_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1) + 10 * np.eye(5)
    assert gaps_m.min() > 0.05


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"family": "door_way"}, r"'door_way'.*did you mean 'doorway'.*paper_room"),
        ({"scanner": "lidar"}, r"'lidar'.*expected one of terrestrial, rings"),
        ({"rotation": "roll"}, r"'roll'.*expected one of yaw, any"),
        ({"points": 0}, "points is 0"),
        ({"seed": -3}, "seed is -3"),
    ],
)
def test_bad_arguments_say_what_is_expected(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate_pair(**({"family": "closed", "seed": 0} | arguments))
