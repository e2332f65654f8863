"""What speaks against poses: surfaces beside each other, riders, mirror images, things alike."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, transform_points
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.likeness import odd_share, typical_offset
from skipnet.registration.judging.riding import (
    MIN_RIDING,
    MIN_SEEN_AGAIN,
    seen_again,
    silence_riders,
)
from skipnet.registration.pipeline import register
from skipnet.registration.units import likeliest_unit
from skipnet.scans.describing import describe
from skipnet.scans.evidence import build_evidence
from skipnet.scans.range_image import build_range_image
from skipnet.simulation.situations.catalog import SITUATIONS, is_right
from skipnet.simulation.situations.making import block, caster_of, drum, rings, sample, see, upright
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.1
EYE = np.eye(4)


def shifted_by(*shift_m):
    return make_transform(np.eye(3), np.array(shift_m))


def evidence_of(points_m, viewpoint_m=None):
    skipmap = build_skipmap(points_m, VOXEL_M, viewpoint_m)
    image = None if viewpoint_m is None else build_range_image(points_m, viewpoint_m)
    return build_evidence(skipmap, image, np.random.default_rng(0))


def plane(seed, half_m=2.0):
    rng = np.random.default_rng(seed)
    points_m = rng.uniform([-half_m, -half_m, 0.045], [half_m, half_m, 0.055], size=(60_000, 3))
    return points_m + [0.01, 0.01, 0]


def test_a_surface_beside_another_one_is_a_mismatch_and_one_far_off_is_none():
    judge = Judge(evidence_of(plane(0)), evidence_of(plane(1)), 4000, 6.0)
    poses = np.stack([EYE, shifted_by(0, 0, VOXEL_M), shifted_by(0, 0, 5 * VOXEL_M)])
    score = judge.score(poses)
    assert score.support[0] > 0.9 and score.mismatch[0] < 0.01
    assert score.support[1] < 0.1 and score.mismatch[1] > 0.8
    assert score.support[2] == 0 and score.mismatch[2] == 0
    assert score.mismatch_rate[0] < 0.02 < 0.8 < score.mismatch_rate[1]


def test_poses_are_told_apart_by_where_they_differ_alone():
    block_m = sample(block((0.4, 0.4, 0.4), (0.5, 0.2, 0.25)), 8000, np.random.default_rng(2))
    clouds_m = [np.concatenate([plane(seed), block_m]) for seed in (0, 1)]
    judge = Judge(*(evidence_of(cloud_m) for cloud_m in clouds_m), 4000, 6.0)
    slid = shifted_by(0.5, 0, 0)  # the plane hardly minds
    assert judge.decisiveness(EYE, slid[None])[0] > 0.5
    assert judge.decisiveness(slid, EYE[None])[0] == pytest.approx(
        -judge.decisiveness(EYE, slid[None])[0], abs=1e-6
    )
    assert judge.decisiveness(EYE, EYE[None])[0] == 0


def road(body, step_m, seed):
    """A scan from ``step_m`` along a road with poles and a wall, of a sensor on a body."""
    rng = np.random.default_rng(seed)
    solids = block((160, 60, 0.2), (0, 0, -0.1)) + block((0.3, 12, 4), (24, 8, 2))
    solids += [one for x_m in range(-60, 61, 12) for one in drum(0.3, 6.0, (x_m, 7.0, 3.0))]
    solids += [one for x_m in range(-55, 61, 17) for one in block((2, 1, 2), (x_m, -8, 1))]
    T = upright(0.0, (step_m, 0.0, 1.8))
    if body:
        solids = solids + block((4.0, 1.8, 0.5), (step_m, 0.0, 0.6))
    return see(caster_of(solids), T, rings(900, 48, -25, 12), 0.02, rng, 80.0)


def judged_road(body, step_m):
    scans = describe([road(body, 0.0, 1), road(body, step_m, 2)], [np.zeros(3)] * 2)
    evidence_s, evidence_t = (scan.valued_evidence(1.0) for scan in scans)
    T_same = np.linalg.inv(scans[1].T_given_own) @ scans[0].T_given_own
    return Judge(evidence_s, evidence_t, 4000, 6.0), T_same


def test_a_body_that_rides_along_loses_its_say():
    judge, T_same = judged_road(body=True, step_m=6.0)
    silenced = silence_riders(judge, T_same)
    assert silenced.riding_worth > MIN_RIDING
    bare, T_same = judged_road(body=False, step_m=6.0)
    assert silence_riders(bare, T_same).riding_worth < silenced.riding_worth
    for before, after in ((judge.source, silenced.source), (judge.target, silenced.target)):
        lost = after.weights < 0.5 * before.weights
        assert 0 < lost.mean() < 0.5
        range_m = np.linalg.norm(before.points_m - before.range_image.viewpoint_m, axis=1)
        assert range_m[lost].max() < range_m.max() / 2


def test_what_stands_afar_is_seen_again_only_if_the_sensor_stood_still():
    moved, T_same = judged_road(body=True, step_m=6.0)
    still, T_still = judged_road(body=True, step_m=0.0)
    assert seen_again(still, T_still) > MIN_SEEN_AGAIN > seen_again(moved, T_same)
    elsewhere = T_same @ shifted_by(10.0, 0, 0)
    assert seen_again(moved, elsewhere) == 1, "the sensors are not at one place"


def blocks(offset_m, seed):
    """A row of blocks, the last three of which are ``offset_m`` off."""
    solids = block((2.0, 1.0, 0.2), (0.9, 0, -0.1))
    for k in range(10):
        off_m = offset_m if k > 6 else 0.0
        solids += block((0.12, 0.5, 0.3), (0.2 * k + off_m, off_m, 0.15 + off_m))
    rng = np.random.default_rng(seed)
    return sample(solids, 60_000, rng, 0.0005)


def test_what_agrees_exactly_but_for_some_parts_is_odd():
    odd = {}
    for offset_m in (0.0, 0.012):
        scans = describe([blocks(0.0, 1), blocks(offset_m, 2)], [None, None], 0.04)
        T = np.linalg.inv(scans[1].T_given_own) @ scans[0].T_given_own
        odd[offset_m] = odd_share(T, *scans)
    assert odd[0.0] < 0.01 < 0.02 < odd[0.012]


def test_what_is_a_little_larger_agrees_roughly_and_lies_off_everywhere():
    row_m, found = blocks(0.0, 1), {}
    for factor in (1.0, 1.03):
        other_m = blocks(0.0, 2) * factor
        scans = describe([row_m, other_m - other_m.mean(0) + row_m.mean(0)], [None, None], 0.04)
        T = np.linalg.inv(scans[1].T_given_own) @ scans[0].T_given_own
        found[factor] = typical_offset(T, *scans)
    assert 0.3 < found[1.0] < 1.0, "noise alone: half of it lies within two thirds of sigma"
    assert found[1.03] > 3.0


@pytest.mark.parametrize(
    ("kind", "seed", "words"),
    [("arch", 2, "mirror image"), ("arch", 8, "mirror image"), ("part", 6, "")],
)
def test_mirror_images_are_not_registered(kind, seed, words):
    situation = SITUATIONS[kind](seed)
    assert "mirrored" in situation.name and situation.T_target_source is None
    result = register(situation.source_m, situation.target_m)
    assert result.status != "registered" and words in result.reason


def test_a_small_thing_on_a_large_plane_fixes_the_pose():
    situation = SITUATIONS["table"](4)
    result = register(situation.source_m, situation.target_m)
    assert result.status == "registered" and is_right(result.T_target_source, situation)


@pytest.mark.parametrize("name", sorted(SITUATIONS))
def test_a_situation_is_made_of_its_seed_and_its_truth_is_right(name):
    one, again = SITUATIONS[name](4), SITUATIONS[name](4)
    np.testing.assert_array_equal(one.source_m, again.source_m)
    np.testing.assert_array_equal(one.target_m, again.target_m)
    assert min(len(one.source_m), len(one.target_m)) > 500
    if one.T_target_source is not None:
        assert is_right(one.T_target_source, one)
        moved_m = transform_points(one.T_target_source, one.source_m)
        off_m = one.T_target_source.copy()
        off_m[:3, 3] += 0.05 * np.linalg.norm(np.ptp(moved_m, axis=0))
        assert not is_right(off_m, one)


@pytest.mark.parametrize(
    ("factor", "units"),
    [
        (1000.0, ("millimetres", "metres")),
        (1 / 0.3048, ("feet", "metres")),
        (0.0254, ("metres", "inches")),
    ],
)
def test_sizes_that_differ_as_units_do_name_them(factor, units):
    guess = likeliest_unit(3.0 * factor, 3.3)
    assert guess is not None and (guess.source_unit, guess.target_unit) == units
    assert guess.factor == pytest.approx(1 / factor, rel=1e-3)
    assert likeliest_unit(3.0, 4.0) is None and likeliest_unit(0.0, 1.0) is None


def test_a_room_in_millimetres_against_metres_is_refused_and_the_units_are_named():
    rng = np.random.default_rng(5)
    solids = block((8, 6, 0.1), (0, 0, 0)) + block((8, 0.1, 3), (0, 3, 1.5))
    solids += block((0.1, 6, 3), (4, 0, 1.5)) + block((1.5, 0.8, 0.8), (1, 1, 0.4), 0.4)
    solids += block((0.6, 0.6, 1.6), (-2, 0.5, 0.8), 1.0)
    first_m, second_m = (sample(solids, 40_000, rng, 0.003) for _ in range(2))
    result = register(1000 * first_m, second_m)
    assert result.status == "failed"
    assert "millimetres" in result.reason and "metres" in result.reason
