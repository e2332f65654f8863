"""Which small things stand about in one scan."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import transform_points
from skipnet.networks.catalog import find_network
from skipnet.scans.describing import describe
from skipnet.simulation.situations.making import ball, block, sample

FLOOR = block((8, 6, 0.004), (0, 0, 0)) + block((8, 0.004, 2.5), (0, 3, 1.25))
STANDING_M = np.array([[-2.0, 1.0, 0.15], [1.0, -1.5, 0.2], [2.5, 2.0, 0.25]])
VOXEL_M = 0.1


def scan_of(solids):
    points_m = sample(solids, 120_000, np.random.default_rng(0), 0.003)
    return describe((points_m, points_m), (None, None), VOXEL_M, 0, find_network("shipped"))[0]


def middles_m(scan):
    """(T, 3) of each thing, in the frame of the points."""
    things, points_m = scan.things, scan.fine_tree.centroids_m
    own_m = [points_m[things.rows[things.numbers == k]].mean(axis=0) for k in range(len(things))]
    return transform_points(scan.T_given_own, np.array(own_m).reshape(-1, 3))


def test_things_are_what_is_small_and_stands_on_a_large_plane():
    solids = FLOOR + block((1.2, 1.2, 1.0), (-2.5, -1.5, 0.5)) + ball(0.15, (0.5, 0.5, 1.2))
    for at_m in STANDING_M:
        solids += block((0.25, 0.2, 2 * at_m[2]), at_m)
    scan = scan_of(solids)
    off_m = np.linalg.norm(middles_m(scan)[:, None] - STANDING_M, axis=2)
    # Neither the large box, which may be moved, nor the ball, which hangs in the air.
    assert off_m.shape == (3, 3)
    assert sorted(off_m.argmin(axis=1)) == [0, 1, 2] and off_m.min(axis=1).max() < 0.1


def test_slivers_of_larger_surfaces_are_not_bulky():
    seat_m, cup_m = np.array([[0.5, -1.0, 0.13], [-1.0, 0.5, 0.15]])
    seat = block((0.35, 0.35, 0.004), seat_m)  # one layer, off the floor
    scan = scan_of(FLOOR + seat + block((0.25, 0.25, 0.3), cup_m))
    for at_m, is_bulky in zip(middles_m(scan), scan.things.is_bulky, strict=True):
        assert np.allclose(at_m, cup_m if is_bulky else seat_m, atol=0.1)
    assert sorted(scan.things.is_bulky) == [False, True]


def test_an_empty_room_has_none():
    things = scan_of(FLOOR).things
    assert len(things) == 0 and not things.stands_out.any()
