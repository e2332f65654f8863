"""Changes of a pair that may not change what is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skipnet.geometry import invert, pose_error
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import INVARIANTS
from skipnet.studies.invariants import CHANGES, Case, outcome_of, simulated, try_case

EXACT = ("as it came", "swapped", "moved before", "other order", "every point twice")
EXACT += ("twice as large", "one stray at 1000 km", "5 % far clutter")


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", INVARIANTS.scene(999), points=8000).pair


@settings(max_examples=8, deadline=None, derandomize=True, database=None)
@given(st.lists(st.sampled_from(EXACT[1:]), min_size=1, max_size=3), st.integers(0, 2**32))
def test_what_changes_nothing_that_matters_leaves_the_answer_right(pair, names, seed):
    rng = np.random.default_rng(seed)
    for name in names:
        pair = CHANGES[name](pair, rng)
    assert outcome_of(pair)["outcome"] == "right", (names, seed)


@settings(max_examples=4, deadline=None, derandomize=True, database=None)
@given(st.lists(st.sampled_from(list(CHANGES)[-3:]), min_size=1, max_size=3, unique=True))
def test_what_takes_something_away_brings_no_wrong_answer(pair, names):
    for name in names:
        pair = CHANGES[name](pair, np.random.default_rng(0))
    assert outcome_of(pair)["outcome"] != "wrong", names


def test_a_changed_pair_has_the_truth_that_goes_with_it(pair):
    rng = np.random.default_rng(0)
    swapped = CHANGES["swapped"](pair, rng)
    assert np.allclose(swapped.T_target_source @ pair.T_target_source, np.eye(4))
    moved = CHANGES["moved before"](pair, rng)
    there_m = moved.source_m @ moved.T_target_source[:3, :3].T + moved.T_target_source[:3, 3]
    assert np.linalg.norm(there_m.mean(axis=0) - moved.target_m.mean(axis=0)) < 5
    larger = CHANGES["twice as large"](pair, rng)
    assert np.allclose(larger.T_target_source[:3, 3], 2 * pair.T_target_source[:3, 3])
    assert len(CHANGES["every point twice"](pair, rng).source_m) == 2 * len(pair.source_m)


def test_what_becomes_of_a_pair_is_told_apart(pair):
    case = Case(lambda: pair, "as it came", "a pair")
    assert try_case(case)["outcome"] == "right" and try_case(case)["shift_m"] < 0.03
    T_false = invert(pair.T_target_source) @ np.diag([-1.0, -1, 1, 1])
    false = outcome_of(replace(pair, T_target_source=T_false))
    assert false["outcome"] == "wrong"
    nothing = replace(pair, source_m=pair.source_m[:3])
    assert outcome_of(nothing)["outcome"] == "refused"
    rotation_rad, _ = pose_error(
        register(pair.source_m, pair.target_m).T_target_source, pair.T_target_source
    )
    assert rotation_rad < pair.success_rotation_rad


def test_a_cut_doorway_is_not_taken_for_its_quarter_turn():
    change = "a fifth cut off each"
    case = Case(lambda: simulated("doorway", 180_005), change, "doorway/180005")
    outcome = try_case(case)
    assert outcome["rotation_deg"] > 1  # the truth is not found ...
    assert outcome["outcome"] == "refused"  # ... and that is known
