"""What two scans differ by in small pieces, though each is a part of something larger."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, transform_points
from skipnet.registration.judging.pieces import _HALF_SLICES, Pieces, _ends_behind, compare_pieces
from skipnet.registration.pipeline import register
from skipnet.scans.describing import describe
from skipnet.simulation.situations.making import between, block, caster_of, rings, see, upright
from skipnet.types import Status

SEATS = [(-4.0 + 1.1 * i, -2.1 + 0.7 * j) for i in range(4) for j in range(7)]
BAG_M = np.array([0.3, 0.35, 0.35])
SEAT_HIGH_M = 0.42
FIRST, SECOND = (1, 5, 9, 12, 16, 20, 23, 26), (0, 3, 7, 11, 14, 18, 21, 25)
WAYS = rings(900, 110, -55.0, 50.0)
EYES_M = (0.4, 0.6, 2.8), (0.8, -0.7, 2.7)


def hall(bags=(), hung_m=()):
    """Benches in a row, bags on some of their seats, and what hangs in the air."""
    solids = block((10, 8, 0.1), (0, 0, -0.05)) + block((10, 8, 0.1), (0, 0, 3.65))
    solids += block((0.1, 8, 3.6), (-5, 0, 1.8)) + block((0.1, 8, 3.6), (5, 0, 1.8))
    solids += block((10, 0.1, 3.6), (0, -4, 1.8)) + block((10, 0.1, 3.6), (0, 4, 1.8))
    solids += block((1.2, 5.0, 0.6), (4.2, -0.8, 0.3)) + block((0.4, 1.5, 2.0), (3.0, 3.1, 1.0))
    for x_m in sorted({x_m for x_m, _ in SEATS}):
        solids += block((0.45, 4.9, SEAT_HIGH_M), (x_m, 0, SEAT_HIGH_M / 2))
        solids += block((0.08, 4.9, 0.5), (x_m - 0.25, 0, 0.6))
    for seat in bags:
        solids += block(BAG_M, (*SEATS[seat], SEAT_HIGH_M + BAG_M[2] / 2), 0.3)
    for place_m in hung_m:
        solids += block((0.3, 0.3, 0.3), place_m)
    return solids


def two_looks(first, second, seed=0):
    rng = np.random.default_rng(seed)
    poses = [upright(yaw, eye_m) for yaw, eye_m in zip((0.5, -2.0), EYES_M, strict=True)]
    clouds_m = [
        see(caster_of(solids), T, WAYS, 0.005, rng)
        for solids, T in zip((first, second), poses, strict=True)
    ]
    return *clouds_m, between(*poses)


def compared(first, second, viewpoint="auto"):
    source_m, target_m, T = two_looks(first, second)
    scans = describe((source_m, target_m), (viewpoint,) * 2)
    T_own = invert(scans[1].T_given_own) @ T @ scans[0].T_given_own
    return compare_pieces(T_own, *scans), scans, T_own


def test_other_bags_on_equal_benches_tell_two_halls_apart():
    source_m, target_m, T = two_looks(hall(FIRST), hall(SECOND))
    result = register(source_m, target_m)
    assert np.linalg.norm((result.T_target_source - T)[:3, 3]) < 0.05
    assert result.status is Status.AMBIGUOUS and "small things" in result.reason
    found, scans, _ = compared(hall(FIRST), hall(SECOND))
    gone_m = transform_points(upright(-2.0, EYES_M[1]) @ scans[1].T_given_own, found.gone_m)
    stood_m = np.array([(*SEATS[seat], SEAT_HIGH_M + BAG_M[2] / 2) for seat in FIRST + SECOND])
    off_m = np.linalg.norm(gone_m[:, None] - stood_m, axis=2).min(axis=1)
    assert found.is_another
    assert (off_m < BAG_M.max()).sum() >= len(off_m) - 1  # a sliver of a bench apart


@pytest.mark.parametrize("moved", [0, 1])
def test_a_hall_in_which_a_bag_was_moved_is_registered(moved):
    source_m, target_m, T = two_looks(hall(FIRST), hall((*SECOND[:moved], *FIRST[moved:])))
    result = register(source_m, target_m)
    assert np.linalg.norm((result.T_target_source - T)[:3, 3]) < 0.05
    assert result.status is Status.REGISTERED, result.reason
    assert len(result.findings.pieces.gone_m) <= 2 * moved


def test_what_hangs_in_the_air_is_no_thing_that_lies_about():
    places_m = np.random.default_rng(1).uniform((-4, -3, 1.4), (0, 3, 2.6), (8, 3))
    found, _, _ = compared(hall(FIRST, places_m), hall(FIRST))
    assert len(found.gone_m) == 0


def test_what_is_gone_does_not_hang_on_which_scan_is_the_source():
    there, scans, T_own = compared(hall(FIRST), hall(SECOND))
    back = compare_pieces(invert(T_own), *scans[::-1])
    assert back.again == there.again
    moved_m = transform_points(T_own, back.gone_m)
    assert np.allclose(np.sort(moved_m, axis=0), np.sort(there.gone_m, axis=0), atol=1e-9)


def test_nobody_can_tell_what_an_unknown_sensor_looked_through():
    found, _, _ = compared(hall(FIRST), hall(SECOND), None)
    assert found.again == len(found.gone_m) == 0


def test_a_place_is_looked_through_if_no_ray_beside_it_ends_before():
    rng = np.random.default_rng(0)
    asked, ways = (v / np.linalg.norm(v, axis=1)[:, None] for v in rng.normal(size=(2, 400, 3)))
    slices = ((ways[:, 0] + 1) * _HALF_SLICES).astype(np.int16)
    ways, slices = ways[np.argsort(slices)], np.sort(slices)
    wide, least_m, ranges_m = rng.uniform(0.02, 0.3, 400), rng.uniform(1, 3, 400), np.full(400, 2.9)
    ranges_m[::7] = 1.5
    near = np.linalg.norm(asked[:, None] - ways, axis=2) < wide[:, None]
    expected = near.any(axis=1) & (~near | (ranges_m > least_m[:, None])).all(axis=1)
    assert 0 < expected.sum() < near.any(axis=1).sum()
    assert (_ends_behind(asked, wide, least_m, ways, ranges_m, slices) == expected).all()


@pytest.mark.parametrize(
    ("gone", "again", "parts", "share", "is_another"),
    [
        (5, 8, 5, 0.05, True),
        (5, 9, 5, 0.05, False),  # most is there again
        (5, 0, 5, 0.02, False),  # a few books of a library
        (4, 0, 4, 0.05, False),
        (12, 30, 15, 0.2, True),  # beds and lockers are there again, what lies on them is not
        (12, 30, 15, 0.05, False),
        (0, 0, 4, 0.5, True),
        (0, 0, 3, 0.9, False),  # a car or a chair
    ],
)
def test_most_of_what_lies_about_must_be_gone(gone, again, parts, share, is_another):
    assert Pieces(again, np.ones((gone, 3)), np.ones((parts, 3)), share).is_another == is_another
