"""From candidates to an answer: align, judge again, slide; then align the best finely, decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.geometry import invert, rotation_angle_rad, transform_points
from skipnet.registration.aligners import Aligner, DenseAligner, SparseAligner
from skipnet.registration.answer import Answer
from skipnet.registration.contenders import Contenders
from skipnet.registration.examining import (
    HARMFUL_VIOLATION,
    HARMLESS_OVERLAP,
    REPEATED_ON_MAP,
    REPEATED_SCORE,
    REPEATED_TOTAL,
    find_out,
)
from skipnet.registration.findings import Findings
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import Score
from skipnet.registration.judging.sliding import MIN_DECISIVE
from skipnet.registration.verdict import decide, may_be_registered
from skipnet.registration.weighing import Weighed, weigh
from skipnet.scans.scan import Scan
from skipnet.types import BoolArray, FloatArray

LITTLE_GAINED = 2.0
"""By how much a confidence's logit may rise where a slide makes a score rise by three tenths, and
the lead with it. (A slide out of what was seen as free can make it rise by 4.)"""
GAINED_NEAR = 2.0
"""By how much a confidence's logit may rise once GICP has nearer correspondences: of 111 alignments
of simulated and development pairs by 1.4 at most, and by 0.3 where none could be registered."""
RISES = 1.5
"""Times that a candidate's score may rise when it is aligned once more."""
NEAR_RAD, NEAR_VOXELS = float(np.deg2rad(15.0)), 12.0
"""A rival turned by less, that brings the source's middle so near, is the pose itself, off a little
along what hardly held it: chosen in sight of simulated tables (4 to 12 degrees)."""
FINALISTS = 10
"""Poses that stay in the running when the next generator is asked."""


def aligner_of(
    source: Scan, target: Scan, judge: Judge, samples: int, by_normals: bool = False
) -> Aligner:
    """What aligns two scans finely, candidates with so many voxels; scans of few lines take GICP,
    unless it is known that their normals are firm."""
    if by_normals or not (source.is_sparse or target.is_sparse):
        return DenseAligner(source, target, judge, samples)

    def may_count(score: Score) -> bool:
        return may_be_registered(score, judge.blind, gained=GAINED_NEAR)

    return SparseAligner(source, target, judge, samples, may_count)


def enter(running: Contenders, fresh: FloatArray, aligner: Aligner) -> Contenders:
    """Align (C, 4, 4) fresh candidates a little; the best distinct ones of all are in the running.

    Args:
        running: those before, aligned already; the best few of them stay.
        fresh: new candidates.
        aligner: of both scans.
    """
    if len(fresh) == 0:
        return running
    everyone = running[:FINALISTS].joined(aligned(fresh, running, aligner))
    return everyone[aligner.judge.distinct(everyone.T_target_source, everyone.score)]


def aligned(fresh: FloatArray, running: Contenders, aligner: Aligner) -> Contenders:
    """(C, 4, 4) fresh candidates aligned a little, but for those that others leave far behind.

    Where no pose is near being registered few slide: all do, once more, when one may be.
    """
    roughly = aligner.prepare(fresh, fresh, running.best_total)
    is_hopeless = not may_be_registered(roughly.score, aligner.judge.blind, gained=LITTLE_GAINED)
    return aligner.slid(roughly, running.best_total, is_hopeless)


def realigned(running: Contenders, aligner: Aligner) -> Contenders:
    """All of them aligned once more, from where they are: what is right stays, or comes nearer, and
    so does what can rival it."""
    again = aligner.prepare(running.coarse, running.T_target_source, 0.0)
    again = aligner.slid(again, 0.0, is_hopeless=False)
    return again[aligner.judge.distinct(again.T_target_source, again.score)]


def rivalled(answer: Answer, fresh: FloatArray, running: Contenders, aligner: Aligner) -> Answer:
    """A registered answer after (C, 4, 4) fresh candidates: they cost it some of its lead, or,
    where they might be as good, all are aligned once more and weighed again."""
    found = answer.findings
    assert found is not None
    rivals, top = aligned(fresh, running, aligner), running.best_total
    rivals = rivals[aligner.judge.others(answer.T_target_source, rivals.T_target_source)]
    if may_rival(rivals.score, found, top).any():
        everyone = running[:FINALISTS].joined(rivals)
        return settle(realigned(everyone, aligner), aligner)
    found = replace(found, margin=min(found.margin, 1 - rivals.best_total / top))
    return replace(answer, verdict=decide(found), findings=found)


def still_rivals(T_best: FloatArray, known: FloatArray, aligner: Aligner) -> FloatArray:
    """Those of (K, 4, 4) known rivals of a (4, 4) pose that are others than it, without the near
    ones that what tells them apart speaks against: a rougher look could not tell these from the
    pose, but they are no repeat of it, further on in a pattern.
    """
    judge = aligner.judge
    known = judge.apart(T_best, known)
    apart, centre_m = invert(T_best) @ known, judge.source.centre_m
    off_m = np.linalg.norm(transform_points(apart, centre_m[None])[:, 0] - centre_m, axis=1)
    near = off_m < NEAR_VOXELS * judge.voxel_size_m
    near &= rotation_angle_rad(apart[:, :3, :3]) < NEAR_RAD
    if not near.any():
        return known
    T = aligned(known[near], Contenders.none(), aligner).T_target_source
    T = T[judge.others(T_best, T)]
    held = judge.decisiveness(T_best, T) >= MIN_DECISIVE
    return np.concatenate([known[~near], T[~held]])


def may_rival(score: Score, found: Findings, best_total: float) -> BoolArray:
    """(C,) which candidates might explain the data as well as the best pose, if they are aligned
    once more, by what is asked of them first.

    Args:
        score: of the candidates.
        found: about the best pose.
        best_total: its score.
    """
    share = REPEATED_ON_MAP if found.is_blind else REPEATED_SCORE
    may: BoolArray = RISES * score.total >= max(share * best_total, REPEATED_TOTAL)
    if RISES * found.violation >= HARMFUL_VIOLATION:
        may |= RISES * score.overlap >= HARMLESS_OVERLAP
    return may


def settle(running: Contenders, aligner: Aligner, is_refused: bool = False) -> Answer:
    """Judge those in the running with all evidence, align the best one finely, and decide.

    Where none of them can be registered, the best one, which is not to be used, stays as it is.
    """
    return conclude(weigh(running, aligner), aligner, is_refused) if len(running) else Answer.none()


def conclude(weighed: Weighed, aligner: Aligner, is_refused: bool = False) -> Answer:
    """See ``settle``."""
    running, score, kept = weighed.running, weighed.score, weighed.kept
    first, T = kept[0], running.T_target_source
    best = replace(running.fine[kept[:1]], T_target_source=T[kept[:1]])
    if not is_refused:
        best = aligner.finish(best, T[first], score.total[first])
    findings = find_out(aligner.judge, aligner, best, score, first, weighed.rivals)
    kept = kept[:FINALISTS]
    return Answer(
        running.coarse[kept], T[kept], best.T_target_source[0], decide(findings), findings
    )
