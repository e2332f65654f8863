"""One thing or two that are alike: small things that are gone, surfaces that part."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, random_rotation, transform_points
from skipnet.networks.catalog import find_network
from skipnet.registration import searching
from skipnet.registration.judging.forks import find_forks
from skipnet.registration.judging.furnishing import compare_things
from skipnet.registration.pipeline import register
from skipnet.scans.describing import describe
from skipnet.simulation.situations.alike import INSIDE_RINGS, alike
from skipnet.simulation.situations.making import (
    between,
    block,
    caster_of,
    drum,
    fused,
    sample,
    see,
    upright,
)
from skipnet.types import Status

TABLE = block((1.6, 0.8, 0.06), (-2.2, 1.6, 0.72), 0.3) + block((0.3, 0.3, 0.7), (-2.2, 1.6, 0.35))
CHAIR = (0.5, 0.5, 0.9)
ELSEWHERE = np.array([[2.9, 0.4], [-1.1, -2.1], [1.9, 2.2], [-3.1, -0.6], [0.3, 2.3], [-2.9, -2.0]])
STANDS = np.array([[1.7, 1.1], [-2.4, -1.1], [2.6, -1.3], [-0.9, 1.9], [1.2, -1.9], [-2.0, 0.2]])
PLATE = block((120.0, 70.0, 9.0), (0, 0, 4.5)) + block((120.0, 9.0, 60.0), (0, 30.0, 30.0))
PLATE += drum(9.0, 22.0, (-34.0, -10.0, 20.0)) + block((18.0, 12.0, 16.0), (24.0, 6.0, 17.0), 0.4)
BOSS_M = np.array([38.0, -14.0, 21.0])
BOSS = drum(8.0, 26.0, BOSS_M)


def room(stands_m, chair_m=(0.2, -2.4)):
    solids = block((8, 6, 0.1), (0, 0, -0.05)) + block((8, 6, 0.1), (0, 0, 2.75)) + TABLE
    solids += block((0.1, 6, 2.7), (4, 0, 1.35)) + block((0.1, 4, 2.7), (-4, -1, 1.35))
    solids += block((8, 0.1, 2.7), (0, -3, 1.35)) + block((8, 0.1, 2.7), (0, 3, 1.35))
    solids += block((0.5, 1.2, 1.9), (3.6, 2.2, 0.95)) + block(CHAIR, (*chair_m, 0.45), 0.5)
    for k, at_m in enumerate(stands_m):
        size_m = 0.2 + 0.03 * (k % 3), 0.25, 0.3 + 0.02 * k
        solids += block(size_m, (*at_m, size_m[2] / 2), 0.5 * k)
    return solids


def two_looks(first, second, seed=0):
    rng = np.random.default_rng(seed)
    poses = [upright(0.4, (0.3, 0.2, 1.5)), upright(-1.0, (-0.4, -0.2, 1.4))]
    clouds_m = [
        see(caster_of(solids), T, INSIDE_RINGS, 0.004, rng)
        for solids, T in zip((first, second), poses, strict=True)
    ]
    return *clouds_m, between(*poses)


def own(scans, T):
    source, target = scans
    return invert(target.T_given_own) @ T @ source.T_given_own


def described(source_m, target_m, viewpoint="auto"):
    return describe((source_m, target_m), (viewpoint,) * 2, None, 0, find_network("shipped"))


def right(T, T_true):
    return np.linalg.norm((T - T_true)[:3, 3]) < 0.05


def test_a_room_in_which_all_that_lies_about_is_another_is_not_registered():
    source_m, target_m, T = two_looks(room(STANDS), room(ELSEWHERE))
    result = register(source_m, target_m)
    assert right(result.T_target_source, T)
    assert result.status is Status.AMBIGUOUS and "small things" in result.reason
    gone_m = result.findings.furnishing.gone_m
    # In the target's frame, where it stood: each is one of the places, give or take its size.
    poses = upright(-1.0, (-0.4, -0.2, 1.4))
    stands_m = transform_points(poses, gone_m)[:, None, :2]
    off_m = np.linalg.norm(stands_m - np.concatenate([STANDS, ELSEWHERE]), axis=2).min(axis=1)
    assert len(gone_m) >= 6 and off_m.max() < 0.3


@pytest.mark.parametrize("moved", [0, 2])
def test_a_room_in_which_a_chair_and_a_few_things_were_moved_is_registered(moved):
    stands_m = np.concatenate([ELSEWHERE[:moved], STANDS[moved:]])
    source_m, target_m, T = two_looks(room(STANDS), room(stands_m, chair_m=(1.0, 2.4)))
    result = register(source_m, target_m)
    assert right(result.T_target_source, T)
    assert result.status is Status.REGISTERED, result.reason
    assert result.findings.furnishing.again > len(result.findings.furnishing.gone_m) >= moved


def test_nobody_can_tell_what_an_unknown_sensor_looked_through():
    source_m, target_m, T = two_looks(room(STANDS), room(ELSEWHERE))
    scans = described(source_m, target_m, None)
    found = compare_things(own(scans, T), *scans)
    assert found.again == 0 and len(found.gone_m) == 0


def test_what_is_gone_does_not_hang_on_which_scan_is_the_source():
    source_m, target_m, T = two_looks(room(STANDS), room(ELSEWHERE))
    scans = described(source_m, target_m)
    there, back = (
        compare_things(own(pair, one), *pair)
        for pair, one in ((scans, T), (scans[::-1], invert(T)))
    )
    assert there.again == back.again
    moved_m = transform_points(own(scans, T), back.gone_m)
    assert np.allclose(np.sort(moved_m, axis=0), np.sort(there.gone_m, axis=0), atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_part_with_one_boss_more_is_another_part(seed):
    rng = np.random.default_rng(seed)
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = random_rotation(rng), rng.uniform(-50, 50, 3)
    source_m, target_m = (sample(solids, 16_000, rng, 0.05) for solids in (PLATE + BOSS, PLATE))
    target_m = transform_points(turn, target_m)
    result = register(source_m, target_m)
    assert result.status is Status.AMBIGUOUS
    scans = described(source_m, target_m, None)
    boss_m = transform_points(turn, BOSS_M[None])
    forks_m = transform_points(scans[1].T_given_own, find_forks(own(scans, turn), *scans))
    assert np.linalg.norm(forks_m - boss_m, axis=1).min() < 8.0
    if not len(result.findings.alternatives):  # else it is in doubt before it is asked
        assert "surfaces part" in result.reason
        assert np.allclose(result.details["surfaces_part_at_m"], forks_m, atol=1.0)


def test_the_same_part_seen_from_other_sides_is_the_same_part():
    rng = np.random.default_rng(3)
    sides = np.array([[0, -180, 120], [150, -80, 90], [-140, -90, 130], [30, -60, 190]], float)
    source_m = fused(PLATE + BOSS, sides[:3], (0, 0, 15), 0.05, rng)
    target_m = sample(PLATE + BOSS, 16_000, rng, 0.05)
    scans = described(source_m, target_m, None)
    assert len(find_forks(own(scans, np.eye(4)), *scans)) == 0
    other = described(source_m, sample(PLATE, 16_000, rng, 0.05), None)
    assert len(find_forks(own(other, np.eye(4)), *other)) > 0


@pytest.mark.parametrize(
    "kind", ["office, other small things", "part, one other boss", "bust, another head"]
)
def test_what_the_study_calls_alike_is_not_registered(kind):
    two = alike(kind, 91_001)
    assert register(two.source_m, two.target_m).status is not Status.REGISTERED


def cut_in_two(solids, seed, band_m=34.0):
    """Samples of two parts that share a band, the second one turned."""
    rng = np.random.default_rng(seed)
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = random_rotation(rng), rng.uniform(-50, 50, 3)
    source_m, target_m = (sample(solids, 24_000, rng, 0.05) for _ in range(2))
    target_m = target_m[target_m[:, 0] < band_m]
    return source_m[source_m[:, 0] > -band_m], transform_points(turn, target_m), turn


def test_poses_under_which_surfaces_part_are_no_rivals_of_the_right_one(monkeypatch):
    source_m, target_m, T = cut_in_two(PLATE + BOSS, seed=0)
    result = register(source_m, target_m)
    assert np.linalg.norm((result.T_target_source - T)[:3, 3]) < 0.1  # of 120
    assert result.status is Status.REGISTERED, result.reason
    monkeypatch.setattr(searching, "_without_forked", lambda answer, aligner: answer)
    before = register(source_m, target_m)
    assert before.status is Status.AMBIGUOUS and "distinct poses" in before.reason


def test_a_wheel_without_a_mark_stays_in_doubt():
    wheel = drum(40.0, 12.0, (0, 0, 6.0)) + drum(12.0, 30.0, (0, 0, 10.0))
    for angle in np.arange(8) * np.pi / 4:
        wheel += block((8.0, 6.0, 12.0), (42 * np.cos(angle), 42 * np.sin(angle), 6.0), angle)
    source_m, target_m, _ = cut_in_two(wheel, seed=1)
    assert register(source_m, target_m).status is not Status.REGISTERED
