"""The runs behind the claims on being fooled and on accuracy: what they count, on small samples."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import VIGILANCE_ALIKE
from skipnet.simulation.situations.alike import KINDS
from skipnet.studies import vigilance
from skipnet.studies.accuracy import bound_m
from skipnet.studies.vigilance import (
    OPEN,
    POSITIVES,
    SAME_SHELL,
    Alike,
    Case,
    Outcome,
    Setting,
    alike_cases,
    calibration_error,
    cases,
    counts_table,
    surprises_table,
    try_case,
)


def test_half_of_the_negatives_share_a_shell_and_no_scene_meets_itself():
    chosen = cases(10, 40)
    negatives = [case for case in chosen if case.group.startswith("negatives")]
    assert len(negatives) == 40 and len(chosen) == 40 + 10 * len(POSITIVES) + 2 * len(OPEN)
    assert sum(case.setting == SAME_SHELL for case in negatives) == 20
    assert all(case.source_seed != case.target_seed for case in negatives)
    others = [case for case in chosen if case not in negatives]
    assert all(case.source_seed == case.target_seed for case in others)


def test_what_is_alike_comes_in_all_kinds_in_turn_and_is_never_right():
    chosen = alike_cases(20, skip=3)
    assert [case.kind for case in chosen[:10]] == [*list(KINDS)[3:], *list(KINDS)[:3]]
    assert len({case.seed for case in chosen}) == 20
    assert all(case.seed in VIGILANCE_ALIKE for case in chosen)
    found = try_case(Alike("part, other bosses", 62_104))
    assert not found["right"] and found["status"] in ("registered", "ambiguous", "failed")


def outcome(group, status, confidence, right, translation_mm=1.0):
    case = Case(group, SAME_SHELL, 1, 1)
    return case, Outcome(status, confidence, right, 0.0, translation_mm)


def test_the_table_counts_by_status_and_by_being_right():
    outcomes = [
        outcome("rooms", "registered", 0.9, True, 2.0),
        outcome("rooms", "registered", 0.8, False, 3000.0),
        outcome("rooms", "failed", 0.2, True, 4.0),
        outcome("rooms", "ambiguous", 0.2, False, 3000.0),
    ]
    assert counts_table(outcomes).rows == (("rooms", "2 of 4", "1", "1", "1", "1", "3.00"),)
    surprises = surprises_table(outcomes).rows
    assert [row[1:3] for row in surprises] == [("registered", "0.80"), ("failed", "0.20")]


def test_the_calibration_error_leaves_out_scenes_without_one_right_answer():
    outcomes = [
        outcome("rooms", "registered", 0.9, True),
        outcome("symmetric", "failed", 1.0, False),
    ]
    assert calibration_error(outcomes) == pytest.approx(0.1)


def test_one_room_is_registered_and_two_rooms_are_not():
    setting = Setting("oblique", rotation="yaw")
    same = try_case(Case("same", setting, 3, 3))
    assert same["right"] and same["status"] == "registered"
    different = try_case(Case("negatives", setting, 3, 4))
    assert not different["right"] and different["status"] != "registered"


def test_passers_by_stand_in_the_way_of_both_scans():
    still, busy = (vigilance._pair(Setting("closed", passers_by=n), 3) for n in (0, 4))
    for name in ("source_m", "target_m"):
        one_m, other_m = getattr(still, name), getattr(busy, name)
        assert one_m.shape == other_m.shape and 0.001 < (one_m != other_m).mean() < 0.5
    np.testing.assert_array_equal(
        still.source_m, simulate_pair("closed", 3, rotation="any").pair.source_m
    )


def test_what_is_not_asked_for_needs_no_scenes():
    assert cases(0, 2, skip=2000) and len(alike_cases(10, skip=2000)) == 10
    with pytest.raises(ValueError, match="are not to be had"):
        cases(1, 0, skip=2000)


def test_the_bound_grows_with_the_noise_and_shrinks_with_the_root_of_the_points():
    pairs = [simulate_pair("paper_room", 5, points=points) for points in (20_000, 80_000)]
    few_m, many_m = (bound_m(pair, 0.004) for pair in pairs)
    assert bound_m(pairs[0], 0.008) == pytest.approx(2 * few_m)
    assert 1.6 < few_m / many_m < 2.6
    assert 1e-6 < many_m < 1e-3
    assert np.isfinite(few_m)
