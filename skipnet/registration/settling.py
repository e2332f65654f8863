"""From candidates to an answer: align, judge again, slide, align finely, decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.registration.alignment.refinement import Refinement, refine
from skipnet.registration.alignment.sparse import refine_sparse
from skipnet.registration.alignment.thin_planes import lay_on_planes
from skipnet.registration.answer import Answer
from skipnet.registration.findings import Findings
from skipnet.registration.judging.closer_look import look_closer
from skipnet.registration.judging.judge import (
    FINE,
    HOPELESS,
    ROUGH,
    STRAY_SHARE,
    Score,
    Strictness,
    distinct,
    judge,
)
from skipnet.registration.judging.sliding import (
    MIN_DETERMINED,
    holds,
    holds_against,
    is_weak,
    moves_freely,
    slide,
)
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.verdict import decide
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, IntArray

AMBIGUOUS_LEAD = 0.1
"""A rival whose score comes within this share of the best one's explains the data as well."""
HARMLESS_OVERLAP = 0.2
"""... and so does one that contradicts nothing, if this much agrees and the best pose does ..."""
HARMFUL_VIOLATION = 0.003
"""... contradict what was seen, by this share of all voxels and more."""
CLOSE_LEAD = 0.5
"""A best pose that leads by less is compared with its rivals more strictly."""
CHANCE_SCORE = 0.1
"""What some pose always scores: a lead counts against this, though no rival be found."""
FINALISTS = 10
"""Distinct poses that stay in the running when the next generator is asked."""
MIN_POLISHED = 0.85
"""A final fine alignment that leaves the best pose less than this share of its score is undone."""
SPARSE_FINALISTS = 6
"""Candidates of sparse scans that are worth fine alignment by GICP, which takes one at a time."""
MIN_SPARSE_HOLD = 6.0
"""Voxels that must face a direction in sparse scans: their normals err, and fewer hold nothing."""
SLIDING_FINALISTS = 6
"""So many candidates are slid along directions that few normals hold ..."""
WORTH_SLIDING = 0.5
"""... if they score this share of the best one: a slide adds two thirds to a score at most."""


def settle(
    before: Answer,
    fresh: FloatArray,
    source: Scan,
    target: Scan,
    config: RegistrationConfig,
) -> Answer:
    """Refine the candidates a little, judge them again with all evidence, and decide.

    Args:
        before: the answer so far; its best poses stay in the running.
        fresh: (C, 4, 4) new candidates.
        source: the source scan.
        target: the target scan.
        config: how many samples to use, and the judge's weight.
    """
    coarse = np.concatenate([before.coarse, fresh])
    if len(coarse) == 0:
        return before
    bench = _Bench(source, target, config)
    levels = [(source.coarse, target.coarse), (source.skipmap, target.skipmap)]
    start = np.concatenate([before.finalists, fresh])
    fine = refine(start, levels, samples=config.refine_samples, max_steps=5)
    if bench.is_sparse:
        rough = bench.judge(fine.T_target_source, ROUGH)
        best = bench.distinct(fine.T_target_source, rough)[:SPARSE_FINALISTS]
        best = best[rough.total[best] >= HOPELESS * rough.total.max()]
        fine, coarse = fine[best], coarse[best]
        fine = refine_sparse(fine, source.thinned, target.thinned, bench.voxel_size_m)
    T, score = fine.T_target_source, bench.judge(fine.T_target_source)
    if not bench.is_sparse:
        T, score = bench.slide(fine, score)
    kept = bench.distinct(T, score)
    if score.total[kept[1:]].max(initial=0.0) > (1 - CLOSE_LEAD) * score.total[kept[0]]:
        score = bench.look_closer(T, score)
        kept = bench.distinct(T, score)
    kept = firmest_first(kept, score, fine)
    if bench.is_sparse:
        fine = lay_on_planes(
            fine[kept[:1]],
            source.fine_tree.centroids_m,
            target.fine_tree.centroids_m,
            source.viewpoint_m,
            target.viewpoint_m,
            bench.voxel_size_m,
        )
    else:
        unpolished = replace(fine[kept[:1]], T_target_source=T[kept[:1]])
        fine = polish(T[kept[0]], source, target)
        # What hardly anything holds may drift: then the judge likes it less than before.
        if bench.judge(fine.T_target_source).total[0] < MIN_POLISHED * score.total[kept[0]]:
            fine = unpolished
    findings = bench.summarise(fine, T, score, kept)
    kept = kept[:FINALISTS]
    return Answer(coarse[kept], T[kept], fine.T_target_source[0], decide(findings), findings)


def polish(T_target_source: FloatArray, source: Scan, target: Scan) -> Refinement:
    """The final fine alignment of one (4, 4) pose, with every voxel of the two finer levels."""
    levels = [
        (source.skipmap, target.skipmap),
        (source.fine_skipmap, target.fine_skipmap),
    ]
    return refine(T_target_source[None], levels)


def firmest_first(kept: IntArray, score: Score, fine: Refinement) -> IntArray:
    """Among poses that explain the data about equally well, the firmest held one comes first.

    A plane on a plane may slide until much agrees; three planes that agree are no accident.

    Args:
        kept: (K,) rows of distinct poses, best first.
        score: of all poses.
        fine: their alignment.
    """
    near = kept[score.total[kept] >= (1 - AMBIGUOUS_LEAD) * score.total[kept[0]]]
    held = [
        holds_against(fine.information[row], fine.matched[row], fine.spread_m[row])[0][0]
        * fine.matched[row]
        for row in near
    ]
    first = near[int(np.argmax(held))]
    return np.concatenate([[first], kept[kept != first]])


class _Bench:
    """The judge with both scans before it."""

    def __init__(self, source: Scan, target: Scan, config: RegistrationConfig) -> None:
        self.voxel_size_m = source.skipmap.voxel_size_m
        self.is_sparse = source.is_sparse or target.is_sparse
        self._scans = (source.evidence, source.skipmap), (target.evidence, target.skipmap)
        self.blind = float(np.mean([scan.viewpoint_m is None for scan in (source, target)]))
        self._case = (
            source.evidence,
            target.evidence,
            config.final_samples,
            config.violation_weight,
        )

    def judge(self, T_target_source: FloatArray, strictness: Strictness = FINE) -> Score:
        """Score (C, 4, 4) poses with all samples."""
        return judge(T_target_source, *self._case, strictness)

    def look_closer(self, T_target_source: FloatArray, score: Score) -> Score:
        """Score (C, 4, 4) poses anew, as strictly as the scans' noise allows."""
        return look_closer(T_target_source, score, self._scans, *self._case[2:])

    def distinct(self, T_target_source: FloatArray, score: Score) -> IntArray:
        """Rows of the poses that differ from every better one, best first."""
        order = np.argsort(-score.total, kind="stable")
        centre_m = self._case[0].centre_m
        return order[distinct(T_target_source[order], centre_m, 2 * self.voxel_size_m)]

    def slide(self, fine: Refinement, score: Score) -> tuple[FloatArray, Score]:
        """The poses, the best of them moved along their weak directions, and new scores."""
        T = fine.T_target_source.copy()
        rows = self.distinct(T, score)[:SLIDING_FINALISTS]
        for row in rows[score.total[rows] >= WORTH_SLIDING * score.total[rows[0]]]:
            share, directions = holds(fine.information[row], fine.matched[row])
            for direction in directions[is_weak(share, fine.matched[row])]:
                T[row] = slide(T[row], direction, *self._case)
        slid = (fine.T_target_source != T).any()
        return T, self.judge(T) if slid else score

    def free(self, fine: Refinement) -> tuple[FloatArray, FloatArray]:
        """(F, 3) directions along which one pose can slide and (G, 3) axes about which it can turn.

        Turns are looked for where no slide is free: a plane's or a pipe's would only repeat these.
        The normals of sparse scans are too rough to tell.
        """
        T, centre_m = fine.T_target_source[0], fine.centre_m[0]
        share, directions = holds(fine.information[0], fine.matched[0])
        free = [
            direction
            for part, direction in zip(share, directions, strict=True)
            if is_weak(part, fine.matched[0])
            and (
                (self.is_sparse and part * fine.matched[0] < MIN_SPARSE_HOLD)
                or moves_freely(np.append(np.zeros(3), direction), T, centre_m, *self._case)
            )
        ]
        share, motions = holds_against(fine.information[0], fine.matched[0], fine.spread_m[0])
        weak = motions[(share < MIN_DETERMINED) & motions[:, :3].any(axis=1)]
        turns = [
            motion[:3] / np.linalg.norm(motion[:3])
            for motion in weak
            if not (free or self.is_sparse) and moves_freely(motion, T, centre_m, *self._case)
        ]
        return np.array(free).reshape(-1, 3), np.array(turns).reshape(-1, 3)

    def summarise(
        self, fine: Refinement, T_target_source: FloatArray, score: Score, kept: IntArray
    ) -> Findings:
        """What the verdict rests on.

        Args:
            fine: the best pose, polished.
            T_target_source: (K, 4, 4) all refined candidates.
            score: the judge's figures for these.
            kept: rows of the distinct ones, best first.
        """
        best, rivals = kept[0], kept[1:]
        top = max(float(score.total[best]), 1e-9)
        lead = 1 - score.total[rivals] / top
        harmless = (score.violation[rivals] <= STRAY_SHARE) & (
            score.overlap[rivals] >= HARMLESS_OVERLAP
        )
        harmless &= score.violation[best] >= HARMFUL_VIOLATION
        closest = max(score.total[rivals].max(initial=0.0), CHANCE_SCORE)
        directions, turns = self.free(fine)
        share, _ = holds_against(fine.information[0], fine.matched[0], fine.spread_m[0])
        return Findings(
            overlap=float(score.overlap[best]),
            violation=float(score.violation[best]),
            margin=float(max(1 - closest / top, 0.0)),
            matched=int(fine.matched[0]),
            held_voxels=float(share[0] * fine.matched[0]),
            blind=self.blind,
            covariance=fine.covariance[0],
            free_directions=directions,
            free_turns=turns,
            alternatives=T_target_source[rivals[(lead < AMBIGUOUS_LEAD) | harmless]],
        )
