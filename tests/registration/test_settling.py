"""From candidates to an answer: which of several poses comes first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.geometry import invert
from skipnet.registration import searching, settling
from skipnet.registration.alignment.refinement import Refinement, no_refinement
from skipnet.registration.answer import Answer
from skipnet.registration.contenders import Contenders
from skipnet.registration.findings import Findings
from skipnet.registration.judging.furnishing import Furnishing
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.pieces import Pieces
from skipnet.registration.judging.score import CHANCE_SCORE, Score
from skipnet.registration.judging.sides import Before
from skipnet.registration.pipeline import register
from skipnet.registration.settling import FINALISTS, enter
from skipnet.registration.verdict import decide, may_be_registered
from skipnet.registration.weighing import firmest_first, polished
from skipnet.scans.describing import describe
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.types import Status


def alignment_of(held_shares):
    """Poses whose matches hold the translation along x by these shares, all else firmly."""
    count = len(held_shares)
    information = np.repeat(np.eye(6)[None], count, axis=0)
    information[:, 3, 3] = held_shares
    return Refinement(
        np.repeat(np.eye(4)[None], count, axis=0),
        information,
        np.full(count, 1000),
        np.zeros((count, 3)),
        np.ones(count),
    )


@pytest.mark.parametrize(
    ("total", "first"),
    [
        ((0.50, 0.48, 0.20), 1),  # about as good, and firmly held
        ((0.50, 0.40, 0.20), 0),  # a clear lead counts for more than any hold
        ((0.20, 0.48, 0.50), 2),  # the firm one is best already
    ],
)
def test_of_equally_good_poses_the_firmest_held_one_comes_first(total, first):
    total = np.array(total)
    kept = np.argsort(-total)
    order = firmest_first(
        kept, Score(total, *[total, 0 * total] * 2, 0 * total), alignment_of([1e-4, 0.3, 0.5])
    )
    assert order[0] == first
    assert sorted(order) == sorted(kept)
    assert list(order[1:]) == [row for row in kept if row != first]


GOOD = Findings(
    overlap=0.85,
    violation=0.0,
    margin=0.9,
    support=0.85,
    decisiveness=0.9,
    mismatch=0.01,
    contradiction=0.0,
    closeness=1.0,
    seen_again=1.0,
    riding_worth=0.0,
    matched=10_000,
    held_voxels=50.0,
    weakest_std_voxels=0.5,
    evenly_held=10.0,
    is_sparse=False,
    odd_share=0.0,
    is_mirrored=False,
    blind=0.0,
    are_sided=True,
    covariance=np.eye(6),
    covariance_centre_m=np.zeros(3),
    free_directions=np.zeros((0, 3)),
    free_turns=np.zeros((0, 3)),
    alternatives=np.zeros((0, 4, 4)),
)


def test_a_pose_against_which_nothing_speaks_is_registered():
    verdict = decide(GOOD)
    assert verdict.status is Status.REGISTERED and verdict.confidence > 0.9


LOOSELY = {"typical_offset": 1.3, "closeness": 0.95, "decisiveness": 0.2, "blind": 1.0}
"""What lies as loosely as real figures do, and might lie elsewhere as well."""


@pytest.mark.parametrize(
    ("found", "status", "words"),
    [
        ({"held_voxels": 0.05}, "ambiguous", "next to nothing holds"),
        ({"free_directions": np.eye(3)[:1]}, "ambiguous", "position along"),
        ({"alternatives": np.eye(4)[None]}, "ambiguous", "2 distinct poses"),
        ({"violation": 0.05}, "failed", "saw free space"),
        ({"is_mirrored": True}, "failed", "mirror image"),
        ({"odd_share": 0.1, "blind": 1.0, "closeness": 0.9}, "ambiguous", "alike, not the same"),
        ({"odd_share": 0.02, "blind": 1.0}, "ambiguous", "alike, not the same"),
        ({"before": Before(0.01, np.ones((1, 3)))}, "ambiguous", "1.0% of one scan, such as at (1"),
        ({"odd_share": 0.012, "blind": 1.0}, "ambiguous", "alike, not the same"),
        ({"typical_offset": 7.0, "blind": 0.5}, "ambiguous", "check the units and scales"),
        ({**LOOSELY, "typical_offset": 1.5}, "ambiguous", "off by 1.5 times as much"),
        ({**LOOSELY, "typical_offset": 1.5}, "ambiguous", "merely alike; take scans"),
        ({**LOOSELY, "closeness": 0.9}, "ambiguous", "off by 1.3 times"),
        ({"forks_m": np.ones((1, 3))}, "ambiguous", "at (1, 1, 1) in the target's frame"),
        ({"furnishing": Furnishing(6, np.ones((7, 3)))}, "ambiguous", "7 small things stand in"),
        ({"furnishing": Furnishing(9, np.ones((5, 3)), 1, 4)}, "ambiguous", "4 small things stand"),
        ({"pieces": Pieces(8, np.ones((5, 3)), share=0.1)}, "ambiguous", "5 small things stand in"),
        ({"pieces": Pieces(0, *np.ones((2, 4, 3)), 0.5)}, "ambiguous", "50% of what stands out"),
        ({"pieces": Pieces(0, np.ones((0, 3)), np.ones((4, 3)), 0.5)}, "ambiguous", "(1, 1, 1)"),
        ({"seen_again": 0.7, "is_sparse": True}, "ambiguous", "rides with the sensor"),
        ({"seen_again": 0.7, "riding_worth": 50.0}, "ambiguous", "rides with the sensor"),
    ],
)
def test_what_speaks_against_a_pose_is_said(found, status, words):
    verdict = decide(replace(GOOD, **found))
    assert verdict.status == status and words in verdict.reason
    assert verdict.confidence <= 0.5


@pytest.mark.parametrize(
    "found",
    [
        {"odd_share": 0.02, "blind": 1.0, "closeness": 0.95},
        {"odd_share": 0.02, "blind": 0.0},
        {"odd_share": 0.012, "blind": 0.5},
        {"typical_offset": 1.4, "blind": 1.0},
        LOOSELY,
        {**LOOSELY, "typical_offset": 1.1, "closeness": 0.9},
        {**LOOSELY, "typical_offset": 1.5, "decisiveness": 0.5},
        {**LOOSELY, "typical_offset": 1.5, "blind": 0.5},
    ],
)
def test_what_real_scans_of_one_thing_have_too_speaks_against_nothing(found):
    assert decide(replace(GOOD, **found)).status is Status.REGISTERED


def test_a_few_small_things_that_were_moved_cost_nothing():
    for again, gone, in_bulk in ((7, 7, (3, 5)), (0, 5, (0, 2))):
        things = Furnishing(again, np.ones((gone, 3)), *in_bulk)
        found = replace(GOOD, furnishing=things)
        assert decide(found) == decide(GOOD)


def test_sensors_that_stood_still_before_a_scene_at_rest_need_no_warning():
    assert decide(replace(GOOD, seen_again=0.97, is_sparse=True)).status == "registered"
    # Leaves never match; without rings and without a body nothing need ride along.
    assert decide(replace(GOOD, seen_again=0.7)).status == "registered"


def test_where_nothing_would_contradict_a_fifth_must_agree():
    sure = replace(GOOD, blind=1.0, are_sided=False, margin=1.0, held_voxels=900.0)
    assert decide(replace(sure, support=0.21)).status == "registered"
    verdict = decide(replace(sure, support=0.19))
    assert verdict.status == "failed" and verdict.confidence <= 0.5
    assert decide(replace(sure, support=0.19, blind=0.0)).status == "registered"


def test_where_the_sides_are_known_an_eighth_is_enough_if_it_agrees_closely():
    sure = replace(GOOD, blind=1.0, margin=1.0, held_voxels=900.0, support=0.13, mismatch=0.14)
    assert decide(sure).status == "registered"
    for spoilt in ({"support": 0.11}, {"mismatch": 0.16}, {"closeness": 0.8}):
        assert decide(replace(sure, **spoilt)).status == "failed"


def test_surfaces_that_are_forced_together_are_not_registered():
    loose = replace(GOOD, mismatch=0.25, closeness=0.7)
    assert decide(loose).status == "failed"
    assert decide(replace(loose, mismatch=0.15)).status == "registered"
    assert decide(replace(loose, closeness=0.8)).status == "registered"


def test_little_that_agrees_is_enough_where_nothing_at_all_speaks_against_it():
    little = replace(GOOD, support=0.1, overlap=0.12, margin=0.4, held_voxels=20.0)
    assert decide(little).status == "registered"
    for spoilt in ({"contradiction": 0.001}, {"mismatch": 0.1}, {"closeness": 0.7}):
        assert decide(replace(little, **spoilt)).status == "failed"


def test_gentle_ground_is_held_by_few_voxels_if_these_know_their_place():
    ground = replace(GOOD, held_voxels=0.1, weakest_std_voxels=0.05, overlap=0.4, support=0.4)
    assert decide(ground).status == "registered"
    assert decide(replace(ground, weakest_std_voxels=0.2)).status == "ambiguous"
    assert decide(replace(ground, evenly_held=1.0)).status == "ambiguous"
    # What lies on itself nearly everywhere may be a vase, turned.
    assert decide(replace(ground, overlap=0.9)).status == "ambiguous"


@pytest.mark.parametrize("blind", [0.0, 0.3, 1.0])
def test_what_cannot_be_registered_is_never_registered_whatever_else_is_found(blind):
    rng = np.random.default_rng(8)
    registered = ruled_out = 0
    for _ in range(400):
        support, violation = rng.uniform(0, 0.6), rng.uniform(0, 0.02) * rng.integers(0, 2)
        total = support * rng.uniform(0.3, 1)
        found = replace(
            GOOD,
            support=support,
            overlap=support,
            violation=violation,
            margin=max(1 - max(CHANCE_SCORE, rng.uniform(0, 0.3)) / max(total, 1e-9), 0.0),
            held_voxels=rng.uniform(1, 500),
            blind=blind,
            are_sided=bool(rng.integers(0, 2)),
            contradiction=rng.choice([0.0, 0.01]),
            mismatch=rng.choice([0.0, 0.1]),
        )
        one = np.array([support])
        against = np.array([found.contradiction]), one * found.mismatch / (1 - found.mismatch)
        score = Score(np.array([total]), one, np.array([violation]), one, *against)
        may_be = may_be_registered(score, blind)
        is_registered = decide(found).status is Status.REGISTERED
        assert may_be or not is_registered
        needed = rng.uniform(0.55, 0.99)
        with_lead = may_be_registered(score, blind, margin=found.margin, confidence=needed)
        assert with_lead or not is_registered or decide(found).confidence < needed
        assert may_be or not with_lead  # who knows the lead knows more
        registered, ruled_out = registered + is_registered, ruled_out + (not may_be)
    assert registered > 20 and ruled_out > 20


def test_without_candidates_nothing_may_be_registered():
    assert not may_be_registered(Contenders.none().score, 0.0)


class _CountingAligner:
    """Leaves poses as they are, with a score that falls with their shift along x."""

    def __init__(self):
        self.seen, self.hopeless = [], []
        self.judge, self.blind = self, 0.0

    def prepare(self, coarse, start, rival_total):
        self.seen.append((len(coarse), rival_total))
        total = 1 / (1 + coarse[:, 0, 3])
        return Contenders(coarse, no_refinement(coarse), coarse, Score(total, *[total] * 5))

    def slid(self, aligned, rival_total, is_hopeless):
        self.hopeless.append(is_hopeless)
        return aligned

    def distinct(self, T_target_source, score):
        return np.argsort(-score.total, kind="stable")


def test_all_candidates_slide_unless_none_is_near_being_registered():
    aligner = _CountingAligner()
    for nearest_m in (0.0, 1000.0):  # scores of 1 and 0.001
        enter(Contenders.none(), _shifted(nearest_m, 2000.0), aligner)
    assert aligner.hopeless == [False, True]


def _shifted(*shifts_m):
    poses = np.repeat(np.eye(4)[None], len(shifts_m), axis=0)
    poses[:, 0, 3] = shifts_m
    return poses


def test_what_is_in_the_running_is_not_aligned_again_and_the_best_of_all_come_first():
    aligner = _CountingAligner()
    running = enter(Contenders.none(), _shifted(*range(20)), aligner)
    running = enter(running, _shifted(0.5, 30.0), aligner)
    assert aligner.seen == [(20, 0.0), (2, 1.0)]
    assert len(running) == FINALISTS + 2
    assert list(running.T_target_source[:3, 0, 3]) == [0.0, 0.5, 1.0]
    assert enter(running, np.zeros((0, 4, 4)), aligner) is running


def test_rivals_are_aligned_finely_before_a_closer_look():
    pair = simulate_pair("clutter", 3, points=40_000).pair
    source, target = describe((pair.source_m, pair.target_m), ("auto", "auto"))
    judge = Judge(source.valued_evidence(0.0), target.valued_evidence(0.0), 4000, 10.0)
    aligner = settling.aligner_of(source, target, judge, 1000)
    true = invert(target.T_given_own) @ pair.T_target_source @ source.T_given_own
    poses = true @ _shifted(0.0, 0.0, 8.0)
    poses[1:, :3, 3] += 0.2 * source.skipmap.voxel_size_m  # rough alignment may err by so much
    running = Contenders(poses, no_refinement(poses), poses, judge.score(poses))
    fine = polished(running, np.array([1, 2]), aligner)
    off_m = np.abs(fine.T_target_source[:, :3, 3] - true[:3, 3]).max(axis=1)
    assert off_m[1] < 0.1 * source.skipmap.voxel_size_m
    assert np.array_equal(fine.T_target_source[[0, 2]], poses[[0, 2]])  # not asked, far behind
    assert fine.score.total == pytest.approx(judge.score(fine.T_target_source).total, abs=1e-4)


def _registered(total):
    found, poses = replace(GOOD, margin=1 - 0.05 / total), _shifted(0.0)
    figures, nothing = [np.array([total])] * 3, [np.zeros(1)] * 3
    score = Score(figures[0], figures[1], nothing[0], figures[2], *nothing[1:])
    running = Contenders(poses, no_refinement(poses), poses, score)
    return Answer(poses, poses, poses[0], decide(found), found), running


@pytest.mark.parametrize(("total", "again"), [(0.08, 0), (0.11, 1)])
def test_only_what_may_rival_a_registered_pose_is_aligned_again(monkeypatch, total, again):
    asked = []
    monkeypatch.setattr(settling, "realigned", lambda running, aligner: running)
    monkeypatch.setattr(settling, "settle", lambda running, aligner: asked.append(len(running)))
    answer, running = _registered(0.6)
    aligner = _CountingAligner()
    aligner.others = lambda T_best, T: np.arange(len(T))
    shift_m = 1 / total - 1  # at which the aligner's score is this
    after = settling.rivalled(answer, _shifted(shift_m), running, aligner)
    assert asked == [2] * again
    if not again:  # the rival costs some of the lead
        assert after.findings.margin == pytest.approx(1 - total / 0.6)
        assert after.verdict.confidence < answer.verdict.confidence


def test_scans_that_share_nothing_are_judged_with_all_evidence_once(monkeypatch):
    asked = []

    def counting(running, aligner, is_refused=False):
        asked.append(is_refused)
        return settling.settle(running, aligner, is_refused)

    monkeypatch.setattr(searching, "settle", counting)
    first, second = (simulate_pair("closed", seed, points=20_000).pair for seed in (9101, 9102))
    result = register(first.source_m, second.target_m)
    assert result.status is not Status.REGISTERED and asked == [True]
