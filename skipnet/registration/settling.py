"""From candidates to an answer: align, judge again, slide; then align the best finely, decide."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.registration.aligners import Aligner, DenseAligner, SparseAligner
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.answer import Answer
from skipnet.registration.contenders import Contenders
from skipnet.registration.examining import (
    AMBIGUOUS_MARGIN,
    HARMFUL_VIOLATION,
    HARMLESS_OVERLAP,
    REPEATED_ON_MAP,
    REPEATED_SCORE,
    REPEATED_TOTAL,
    Rivals,
    compare_rivals,
    find_out,
    held_voxels,
)
from skipnet.registration.findings import Findings
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import Score
from skipnet.registration.verdict import decide, may_be_registered
from skipnet.scans.scan import Scan
from skipnet.types import BoolArray, FloatArray, IntArray

COMPARED_LEAD = 0.3
"""Poses that score less than the best one by at most this share of it are compared voxel by voxel
..."""
PREFERRED = 0.05
"""What tells a pose from any of these speaks for it when it does so by this much."""
COMPARED = 6
"""... but no more of them than this."""
CLOSE_MARGIN = 0.5
"""A best pose that leads by less is compared with its rivals more strictly."""
LITTLE_GAINED = 2.0
"""By how much a confidence's logit may rise where a slide makes a score rise by three tenths, and
the lead with it. (A slide out of what was seen as free can make it rise by 4.)"""
GAINED_NEAR = 2.0
"""By how much a confidence's logit may rise once GICP has nearer correspondences: of 111 alignments
of simulated and development pairs by 1.4 at most, and by 0.3 where none could be registered."""
RISES = 1.5
"""Times that a candidate's score may rise when it is aligned once more."""
FINALISTS = 10
"""Poses that stay in the running when the next generator is asked."""


def aligner_of(source: Scan, target: Scan, judge: Judge, samples: int) -> Aligner:
    """What aligns two scans finely, candidates with so many voxels; scans of few lines take
    GICP."""
    if not (source.is_sparse or target.is_sparse):
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


@dataclass(frozen=True)
class Weighed:
    """Those in the running judged with all evidence, before the best one is aligned finely."""

    running: Contenders
    score: Score
    """The judge's figures for them, by a closer look where the race is close."""
    kept: IntArray
    """Rows of the distinct ones, the best one first."""
    rivals: Rivals
    """What the others say of the best one."""

    def may_be_registered(self, blind: float, confidence: float) -> bool:
        """Whether the best one may be registered with so much confidence, whatever its fine
        alignment comes to: a bound, with the lead over all rivals known.

        Args:
            blind: share of the two scans whose viewpoint is unknown.
            confidence: that is needed.
        """
        best, lead = self.score[self.kept[:1]], self.rivals.margin
        is_alone = len(self.rivals.alternatives) == 0
        return is_alone and may_be_registered(best, blind, margin=lead, confidence=confidence)


def weigh(running: Contenders, aligner: Aligner) -> Weighed:
    """Judge those in the running, one or more, with all evidence."""
    judge, fine, T, score = aligner.judge, running.fine, running.T_target_source, running.score
    kept = judge.distinct(T, score)
    if score.total[kept[1:]].max(initial=0.0) > (1 - CLOSE_MARGIN) * score.total[kept[0]]:
        score = judge.closer(T, score)
        kept = judge.distinct(T, score)
    kept = clearest_first(kept, score, fine, T, judge)
    are_narrow = aligner.source.is_narrow and aligner.target.is_narrow
    rivals = compare_rivals(judge, fine, T, score, kept, are_narrow)
    return Weighed(running, score, kept, rivals)


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


def clearest_first(
    kept: IntArray, score: Score, fine: Refinement, T_target_source: FloatArray, judge: Judge
) -> IntArray:
    """Among poses that explain the data about equally well, the one comes first for which what
    tells it from any of the others speaks clearly; if there is none, the firmest held one.

    Args:
        kept: (K,) rows of distinct poses, best first.
        score: of all poses.
        fine: their alignment.
        T_target_source: (C, 4, 4) the poses.
        judge: of both scans.
    """
    near = kept[score.total[kept] >= (1 - COMPARED_LEAD) * score.total[kept[0]]][:COMPARED]
    for row in near:
        others = T_target_source[near[near != row]]
        if judge.decisiveness(T_target_source[row], others).min(initial=1.0) > PREFERRED:
            return np.concatenate([[row], kept[kept != row]])
    return firmest_first(kept, score, fine)


def firmest_first(kept: IntArray, score: Score, fine: Refinement) -> IntArray:
    """Among poses that explain the data about equally well, the firmest held one comes first.

    A plane on a plane may slide until much agrees; three planes that agree are no accident.

    Args:
        kept: (K,) rows of distinct poses, best first.
        score: of all poses.
        fine: their alignment.
    """
    near = kept[score.total[kept] >= (1 - AMBIGUOUS_MARGIN) * score.total[kept[0]]]
    first = near[int(np.argmax([held_voxels(fine, row) for row in near]))]
    return np.concatenate([[first], kept[kept != first]])
