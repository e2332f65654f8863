"""Which of the poses in the running explains the data best, and what its rivals say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.registration.aligners import MIN_POLISHED, Aligner, polish
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.contenders import Contenders
from skipnet.registration.examining import (
    AMBIGUOUS_MARGIN,
    Rivals,
    compare_rivals,
    held_voxels,
)
from skipnet.registration.judging.closer_look import MIN_STANDING
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import Score
from skipnet.registration.verdict import may_be_registered
from skipnet.types import FloatArray, IntArray

COMPARED_LEAD = 0.3
"""Poses that score less than the best one by at most this share of it are compared voxel by voxel
..."""
PREFERRED = 0.05
"""What tells a pose from any of these speaks for it when it does so by this much."""
COMPARED = 6
"""... but no more of them than this."""
CLOSE_MARGIN = 0.5
"""A best pose that leads by less is compared with its rivals more strictly."""


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


def weigh(running: Contenders, aligner: Aligner, one_will_do: bool = False) -> Weighed:
    """Judge those in the running, one or more, with all evidence; where one alternative to the best
    will do, no more are looked for.

    Where the race is close they are aligned finely, too; that counts if another one is best then.
    """
    judge, total = aligner.judge, running.score.total
    kept = judge.distinct(running.T_target_source, running.score)
    if total[kept[1:]].max(initial=0.0) <= (1 - CLOSE_MARGIN) * total[kept[0]]:
        order = _clearest(running, running.score, judge)
        return _weighed(running, running.score, order, aligner, one_will_do)
    score = judge.closer(running.T_target_source, running.score)
    order = _clearest(running, score, judge)
    if aligner.is_sparse or np.array_equal(score.total, total):  # nobody can look closer
        return _weighed(running, score, order, aligner, one_will_do)
    finely = polished(running, kept, aligner)
    fine_score = judge.closer(finely.T_target_source, finely.score)
    fine_order = _clearest(finely, fine_score, judge)
    best, other = running.T_target_source[order[0]], finely.T_target_source[fine_order[0]]
    if len(judge.others(best, other[None])):
        return _weighed(finely, fine_score, fine_order, aligner, one_will_do)
    return _weighed(running, score, order, aligner, one_will_do)


def _clearest(running: Contenders, score: Score, judge: Judge) -> IntArray:
    """(K,) rows of the distinct ones, the best one first, by these figures."""
    T = running.T_target_source
    return clearest_first(judge.distinct(T, score), score, running.fine, T, judge)


def _weighed(
    running: Contenders, score: Score, kept: IntArray, aligner: Aligner, one_will_do: bool
) -> Weighed:
    """The first of (K,) rows against the others."""
    are_narrow = aligner.source.is_narrow and aligner.target.is_narrow
    fine, T = running.fine, running.T_target_source
    rivals = compare_rivals(aligner.judge, fine, T, score, kept, are_narrow, one_will_do)
    return Weighed(running, score, kept, rivals)


def polished(running: Contenders, kept: IntArray, aligner: Aligner) -> Contenders:
    """The best of those in (K,) rows, best first, aligned as finely as can be: rough alignment may
    err by more than a closer look allows."""
    total, T = running.score.total, running.T_target_source.copy()
    rows = kept[total[kept] >= MIN_STANDING * total[kept[0]]][:COMPARED]
    fine = polish(T[rows], aligner.source, aligner.target).T_target_source
    score = aligner.judge.score(fine)
    liked = score.total >= MIN_POLISHED * total[rows]
    T[rows[liked]] = fine[liked]
    score = running.score.replaced(rows[liked], score[liked])
    return replace(running, T_target_source=T, score=score)


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
