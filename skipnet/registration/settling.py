"""From candidates to an answer: align, judge again, slide, align finely, decide."""

from __future__ import annotations

import numpy as np

from skipnet.registration.aligners import Aligner, DenseAligner, SparseAligner
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.answer import Answer
from skipnet.registration.examining import AMBIGUOUS_MARGIN, find_out, held_voxels
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import Score
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.verdict import decide
from skipnet.scans.scan import Scan
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
FINALISTS = 10
"""Distinct poses that stay in the running when the next generator is asked."""


def settle(
    before: Answer,
    fresh: FloatArray,
    source: Scan,
    target: Scan,
    judge: Judge,
    config: RegistrationConfig,
) -> Answer:
    """Refine the candidates a little, judge them again with all evidence, and decide.

    Args:
        before: the answer so far; its best poses stay in the running.
        fresh: (C, 4, 4) new candidates.
        source: the source scan.
        target: the target scan.
        judge: of both.
        config: how many samples to align with.
    """
    coarse = np.concatenate([before.coarse, fresh])
    if len(coarse) == 0:
        return before
    is_sparse = source.is_sparse or target.is_sparse
    aligner: Aligner = (SparseAligner if is_sparse else DenseAligner)(source, target, judge)
    start = np.concatenate([before.finalists, fresh])
    rows, fine, T, score = aligner.prepare(start, config.refine_samples)
    kept = judge.distinct(T, score)
    if score.total[kept[1:]].max(initial=0.0) > (1 - CLOSE_MARGIN) * score.total[kept[0]]:
        score = judge.closer(T, score)
        kept = judge.distinct(T, score)
    kept = clearest_first(kept, score, fine, T, judge)
    best = aligner.finish(fine[kept[:1]], T[kept[0]], score.total[kept[0]])
    findings = find_out(judge, aligner, best, fine, T, score, kept)
    kept = kept[:FINALISTS]
    return Answer(coarse[rows[kept]], T[kept], best.T_target_source[0], decide(findings), findings)


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
