"""The one judge: how well a candidate pose explains both scans, whoever proposed it.

A pose earns the share of each scan's voxels that land on the other scan's surface with agreeing
oriented normals, and pays for every voxel that lands where the other sensor saw free space. The
payment decides between look-alike poses: overlap alone cannot tell the four turns of a square room
apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from skipnet.clouds.statistics import largest
from skipnet.geometry import invert
from skipnet.parallel.threads import side_by_side
from skipnet.registration.judging.closer_look import closeness, look_closer
from skipnet.registration.judging.distinct import distinct
from skipnet.registration.judging.score import (
    FINE,
    MISMATCH_WEIGHT,
    ROUGH,
    Score,
    Strictness,
    violation_cost,
)
from skipnet.registration.judging.states import MAX_SIDES, facing, matches_there, states
from skipnet.scans.evidence import Evidence
from skipnet.types import FloatArray, IntArray

_SOON_JUDGED = 1 << 13
"""Voxels, over all candidates, that are judged before another thread has begun."""
_AT_ONCE = 1 << 20
"""Voxels, over all candidates, judged in one go: some megabytes."""
FREE_WEIGHT = 10.0
"""Voxels that one in free space outweighs where two poses are compared voxel by voxel."""
LOOKED_PAST, LOOKED_PAST_VOXELS = 0.005, 0.25
"""A sensor that saw something behind by this share of the range and so many voxels looked past what
would stand there, be it too little to contradict it."""
FEW_WORTH = 20.0
"""Worth, in voxels, on which poses may differ by chance."""
HOPELESS = 0.1
"""A candidate that scores less than this share of the best one's will not overtake it: right poses
score a third of it and more, before any refinement, in doorways and on streets too."""
APART_VOXELS = 3.0
"""Candidates that bring the source nearer to where another one does are variants of it."""
ROUNDS = ((24, 1000), (100, 400))
"""(samples, candidates that stay) of each round of a shortlist but the last ..."""
LAST_ROUND = (400, 20)
"""... and of the last, among distinct candidates."""


@dataclass(frozen=True)
class Judge:
    """Two scans, and how they are asked about poses of the source in the target's frame."""

    source: Evidence
    target: Evidence
    samples: int
    """Voxels to look at in each scan; the first so many of its sampling order."""
    violation_weight: float
    """How fast contradictions devalue a pose: at a cost of 1 / weight its overlap counts for
    37 % (1 / e)."""

    riding_worth: float = 0.0
    """Voxels' worth of what has no say because it may ride with the sensors."""

    @property
    def voxel_size_m(self) -> float:
        """Edge of a voxel."""
        return self.target.voxel_size_m

    @property
    def blind(self) -> float:
        """Share of the two scans whose viewpoint is unknown: they contradict nothing."""
        return 1 - 0.5 * (self.source.trust + self.target.trust)

    @property
    def are_sided(self) -> bool:
        """Whether it is known, not only likely, from which side both scans' surfaces were seen."""
        surest = (evidence.sides.max(initial=0.0) for evidence in (self.source, self.target))
        return bool(min(surest) > MAX_SIDES)

    def score(self, T_target_source: FloatArray, strictness: Strictness = FINE) -> Score:
        """Score (C, 4, 4) candidate poses by what both scans say about them."""
        at_once = max(1, _AT_ONCE // max(1, self.samples))

        def one_way(T_b_a: FloatArray, a: Evidence, b: Evidence) -> FloatArray:
            """(5, C) what ``_one_way`` says of all candidates, some at a time."""
            some = [T_b_a[i : i + at_once] for i in range(0, max(1, len(T_b_a)), at_once)]
            return np.hstack([_one_way(T, a, b, self.samples, strictness) for T in some])

        poses = T_target_source, invert(T_target_source)
        voxels = min(self.samples, max(len(self.source.points_m), len(self.target.points_m)))
        is_long = voxels * len(T_target_source) > _SOON_JUDGED
        there, back = (side_by_side if is_long else map)(
            one_way, poses, (self.source, self.target), (self.target, self.source)
        )
        overlap, violation, support, contradiction, mismatch = 0.5 * (there + back)
        total = support * np.exp(-self.violation_weight * violation_cost(contradiction))
        total *= np.exp(-MISMATCH_WEIGHT * mismatch / np.maximum(support, 1e-3))
        return Score(total, overlap, violation, support, contradiction, mismatch)

    def overlaps(
        self, T_target_source: FloatArray, ways: Iterable[Strictness]
    ) -> Iterator[FloatArray]:
        """(C,) as ``score`` says of (C, 4, 4) poses, and nothing else, by one strictness after the
        other: where voxels come to lie is looked up once."""
        source, target, samples = self.source, self.target, self.samples
        scans = (T_target_source, source, target), (invert(T_target_source), target, source)
        rows = [b.near.find_moved(T_b_a, a.points_m, samples) for T_b_a, a, b in scans]
        for strictness in ways:
            there, back = (
                matches_there(*scan, row, strictness)[0] @ scan[1].shares(samples)[0]
                for scan, row in zip(scans, rows, strict=True)
            )
            yield 0.5 * (there + back)

    def decisiveness(
        self, T_best: FloatArray, T_rivals: FloatArray, is_motion: bool = False
    ) -> FloatArray:
        """How clearly the voxels on which a pose and each of its rivals differ speak for it.

        Args:
            T_best: (4, 4) the pose.
            T_rivals: (K, 4, 4) other poses.
            is_motion: the rivals are the pose moved a little: what no longer agrees because it
                moved within its own surface says nothing, unless the other sensor looked past it.

        Returns:
            (K,) in -1 to 1: what speaks for the pose alone less what speaks for the rival alone, as
            a share of both; few voxels say little either way.
        """
        poses = np.concatenate([T_best[None], T_rivals])
        there = self._apart(poses, self.source, self.target, is_motion)
        back = self._apart(invert(poses), self.target, self.source, is_motion)
        apart = np.hstack([there, back])
        won, lost = (np.maximum(side, 0).sum(axis=1) for side in (apart, -apart))
        return (won - lost) / (won + lost + FEW_WORTH)

    def _apart(self, T_b_a: FloatArray, a: Evidence, b: Evidence, is_motion: bool) -> FloatArray:
        """(C - 1, S) what each of a's voxels says for the first pose rather than each other one."""
        match, beside, free = states(T_b_a, a, b, self.samples, FINE)
        worth = a.shares(self.samples)[1] * a.weights.sum()
        against = MISMATCH_WEIGHT * beside + FREE_WEIGHT * b.trust * free
        gained: FloatArray = match[0] - match[1:]
        if is_motion:
            points_m, normals = a.points_m[: len(worth)], a.normals[: len(worth)]
            told = facing(T_b_a, points_m, normals)
            if b.range_image is not None:
                lost, least_m = gained > 0, LOOKED_PAST_VOXELS * b.voxel_size_m
                past = b.range_image.in_front(T_b_a[1:], points_m, lost, LOOKED_PAST, least_m)
                told = np.where(past, np.maximum(b.trust, told), told)
            gained = gained * told
        apart: FloatArray = worth * (gained - against[0] + against[1:])
        return apart

    def closer(self, T_target_source: FloatArray, score: Score) -> Score:
        """Score (C, 4, 4) poses anew, as strictly as the scans' noise allows."""
        return look_closer(self, T_target_source, score)

    def closeness(self, T_target_source: FloatArray) -> float:
        """How closely what agrees under a (4, 4) pose does so, see ``closer_look.closeness``."""
        return closeness(self, T_target_source)

    def distinct(self, T_target_source: FloatArray, score: Score) -> IntArray:
        """Rows of the (C, 4, 4) poses that differ from every better one, best first."""
        order = np.argsort(-score.total, kind="stable")
        centre_m, apart_m = self.source.centre_m, 2 * self.voxel_size_m
        return order[distinct(T_target_source[order], centre_m, apart_m)]

    def others(
        self, T_best: FloatArray, T_target_source: FloatArray, voxels: float = 2.0
    ) -> IntArray:
        """Rows of the (C, 4, 4) poses that differ from a (4, 4) one, and from all before them."""
        poses = np.concatenate([T_best[None], T_target_source])
        rows: IntArray = distinct(poses, self.source.centre_m, voxels * self.voxel_size_m)[1:] - 1
        return rows

    def apart(self, T_best: FloatArray, T_target_source: FloatArray) -> FloatArray:
        """Those of (C, 4, 4) poses that are others than a (4, 4) one, and may rival it."""
        poses = T_target_source[self.others(T_best, T_target_source, APART_VOXELS)]
        total = self.score(np.concatenate([T_best[None], poses]), ROUGH).total
        return poses[total[1:] >= HOPELESS * total[0]]

    def shortlist(self, T_target_source: FloatArray) -> FloatArray:
        """Judge (C, 4, 4) candidates with few samples, the better ones with more.

        Returns:
            (K, 4, 4) the best of them, best first, no two within three voxels and three degrees.
        """
        for samples, stay in ROUNDS:
            total = replace(self, samples=samples).score(T_target_source, ROUGH).total
            best = largest(total, stay)
            T_target_source, total = T_target_source[best], total[best]
        T_target_source = T_target_source[total >= HOPELESS * total.max(initial=0.0)]
        # Before the last round, lest variants of one pose crowd out all others.
        far_m = APART_VOXELS * self.voxel_size_m
        T_target_source = T_target_source[distinct(T_target_source, self.source.centre_m, far_m)]
        samples, stay = LAST_ROUND
        total = replace(self, samples=samples).score(T_target_source, ROUGH).total
        best = largest(total, stay)
        return T_target_source[best[total[best] >= HOPELESS * total.max(initial=0.0)]]


def _one_way(
    T_b_a: FloatArray, a: Evidence, b: Evidence, samples: int, strictness: Strictness
) -> FloatArray:
    """(5, C) overlap, violation, support, contradiction and mismatch of ``Score``, a's voxels'."""
    match, beside, free = states(T_b_a, a, b, samples, strictness)
    count, worth = a.shares(samples)
    freely = free.astype(np.float32)
    violation, contradiction = b.trust * (freely @ count), b.trust * (freely @ worth)
    return np.stack([match @ count, violation, match @ worth, contradiction, beside @ worth])
