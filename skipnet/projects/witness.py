"""What the scans themselves say of poses that links imply: surfaces that agree, free space that is
contradicted. One question takes about a millisecond."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.projects.testimony import Testimony
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import FINE
from skipnet.scans.evidence import Evidence
from skipnet.types import BoolArray, FloatArray, IntArray

SAMPLES = 10_000
"""Voxels of each scan that are looked at: few contradict a wrong place among alike ones."""
SURE = replace(FINE, min_facing_cosine=0.26)
"""What contradicts is pooled over many scans, and without this the far walls of a corridor, which
right poses contradict, outweigh the furniture of alike rooms, which wrong ones do."""
STRAY_SHARE = 0.0005
"""Of all voxels of a pair so many contradict by chance: two of 4000."""
MIN_OVERLAP = 0.03
"""A pair of scans of which less agrees says nothing for a place."""
GLANCE_SAMPLES = 1000
"""Voxels of each scan that are looked at first: ..."""
GROSS = 2.0
"""... what contradicts by so many times more than is hopeless is seen in these."""
ALL_ROUND = 0.28
"""A scan that has seen so many of all directions leaves little room for a wrong pose; a camera sees
an eighth of them, 16 rings in a room three tenths, a scanner on open ground two fifths, indoors
most."""
STATION_VOXELS = 1.0
"""Sensors that are closer together stood in one place."""
_DIGITS = 6
"""Of a pose, by which one is known that has been asked about."""
_SAME_SHIFT_VOXELS = 0.3
"""In a search for places, a pose is taken for one that is shifted by no more than this ..."""
_SAME_TURN = 0.01
"""... and of which no axis differs by more."""
_WEIGHT = 10.0
"""Of violations in the judge's total, which nobody asks for here."""
_BYTES = np.dtype("V44")
"""Eleven whole numbers as one key: of target, source, and nine steps that tell the pose."""
Figures = tuple[float, float]
"""Overlap and violation."""


class Witness:
    """Asks the judge about pairs of scans, in whatever places."""

    def __init__(self, evidence: Sequence[Evidence]) -> None:
        self._evidence = evidence
        self._said: dict[tuple[int, int, bytes], FloatArray] = {}
        self._about: dict[bytes, Figures] = {}
        self._at_a_glance: dict[bytes, Figures] = {}
        self.centres_m = np.array(
            [one.centre_m if len(one.points_m) else np.zeros(3) for one in evidence]
        )
        self.voxel_size_m = evidence[0].voxel_size_m
        # Of each scan (4, 3) what tells one pose from another: two axes and the centre, in steps.
        self._told_by = np.zeros((len(evidence), 4, 3))
        self._told_by[:, :2, :2] = np.eye(2) / _SAME_TURN
        self._told_by[:, 3, 2] = 1.0
        self._told_by[:, :3, 2] = self.centres_m
        self._told_by[:, :, 2] /= _SAME_SHIFT_VOXELS * self.voxel_size_m
        self.hopeless = np.inf
        """A single pair that contradicts by more ends the matter."""
        images = [one.range_image for one in evidence]
        self._stations_m = np.array(
            [np.full(3, np.nan) if image is None else image.viewpoint_m for image in images]
        )
        away_m = (e.points_m - at_m for e, at_m in zip(evidence, self.centres_m, strict=True))
        self.reach_m = np.array([np.linalg.norm(a, axis=1).max(initial=-np.inf) for a in away_m])

    def sees_all_round(self, scan: int) -> bool:
        """Whether the scan's free space would contradict most wrong poses."""
        image = self._evidence[scan].range_image
        return image is not None and float(np.mean(image.nearest_m > 0)) >= ALL_ROUND

    def same_station(
        self, target: int | IntArray, source: int | IntArray, T_target_source: FloatArray
    ) -> BoolArray:
        """(C,) whether both sensors stand in one place under (C, 4, 4) poses: one scan, given or
        taken twice; those of two alike rooms are hardly taken from the same place in each."""
        T, source_m = T_target_source, self._stations_m[source]
        place_m = np.squeeze(T[:, :3, :3] @ source_m[..., None], -1) + T[:, :3, 3]
        apart_m = np.linalg.norm(place_m - self._stations_m[target], axis=1)
        same: BoolArray = apart_m < STATION_VOXELS * self.voxel_size_m  # never of unknown places
        return same

    def pair(self, target: int, source: int, T_target_source: FloatArray) -> FloatArray:
        """(2, C) overlap and violation of (C, 4, 4) poses."""
        keys = [(target, source, T.tobytes()) for T in T_target_source[:, :3].round(_DIGITS)]
        fresh = [row for row, key in enumerate(keys) if key not in self._said]
        if fresh:
            said = self._ask(target, source, T_target_source[fresh])
            for row, figures in zip(fresh, said.T, strict=True):
                self._said[keys[row]] = figures
        return np.array([self._said[key] for key in keys]).reshape(-1, 2).T

    def about(
        self, targets: IntArray, sources: IntArray, T_target_source: FloatArray
    ) -> Iterator[tuple[float, float]]:
        """Overlap and violation of (P,) pairs under (P, 4, 4) poses, or under others by a third of
        a voxel beside them that have been asked about; at a glance where that refutes without
        doubt. Nobody is asked before it is taken."""
        steps = np.rint(T_target_source[:, :3] @ self._told_by[sources]).reshape(-1, 9)
        told = np.column_stack([targets, sources, steps]).astype(np.int32)
        for row, key in enumerate(told.view(_BYTES)[:, 0].tolist()):
            said = self._about.get(key)
            if said is None:
                said = self._at_a_glance.get(key)
                if said is None or not self._is_enough(said):
                    pair = int(targets[row]), int(sources[row])
                    said = self._asked(key, *pair, T_target_source[row : row + 1])
            yield said

    def _is_enough(self, seen: Figures) -> bool:
        """Whether what was seen at a glance refutes a pose without doubt, or is nothing at all."""
        overlap, violation = seen
        return violation > GROSS * self.hopeless or overlap == violation == 0

    def _asked(self, key: bytes, target: int, source: int, T_target_source: FloatArray) -> Figures:
        """See ``about``."""
        if key not in self._at_a_glance:
            seen = self._ask(target, source, T_target_source, GLANCE_SAMPLES)[:, 0]
            self._at_a_glance[key] = float(seen[0]), float(seen[1])
        if self._is_enough(self._at_a_glance[key]):
            return self._at_a_glance[key]
        said = self._ask(target, source, T_target_source)[:, 0]
        del self._at_a_glance[key]  # nobody looks there again
        self._about[key] = float(said[0]), float(said[1])
        return self._about[key]

    def meeting(
        self,
        targets: Sequence[int],
        T_targets: FloatArray,
        sources: Sequence[int],
        T_sources: FloatArray,
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Pairs of scans of two groups that may see the same, the nearest first.

        Args:
            targets: T scans of one group.
            T_targets: (T, 4, 4) their poses.
            sources: S scans of the other one.
            T_sources: (S, 4, 4) likewise, in the same frame.

        Returns:
            (P,) the smaller number of each pair, (P,) the larger one, and (P, 4, 4) the pose of the
            second's frame in that of the first.
        """
        firsts, seconds = np.asarray(targets), np.asarray(sources)
        here_m, there_m = (
            np.squeeze(T[:, :3, :3] @ self.centres_m[scans][..., None], -1) + T[:, :3, 3]
            for T, scans in ((T_targets, firsts), (T_sources, seconds))
        )
        apart_m = np.linalg.norm(here_m[:, None] - there_m, axis=2)
        i, k = np.nonzero(apart_m < np.add.outer(self.reach_m[firsts], self.reach_m[seconds]))
        order = np.argsort(apart_m[i, k], kind="stable")
        i, k = i[order], k[order]
        a, b = firsts[i], seconds[k]
        in_order = (a < b)[:, None, None]
        T_a, T_b = (
            np.where(in_order, one, other)
            for one, other in ((T_targets[i], T_sources[k]), (T_sources[k], T_targets[i]))
        )
        return np.minimum(a, b), np.maximum(a, b), invert(T_a) @ T_b

    def judge(self, target: int, source: int, samples: int = SAMPLES) -> Judge:
        """The judge of one pair."""
        return Judge(self._evidence[source], self._evidence[target], samples, _WEIGHT)

    def _ask(
        self, target: int, source: int, T_target_source: FloatArray, samples: int = SAMPLES
    ) -> FloatArray:
        result = np.zeros((2, len(T_target_source)))
        there_m = T_target_source[:, :3, :3] @ self.centres_m[source] + T_target_source[:, :3, 3]
        apart_m = np.linalg.norm(there_m - self.centres_m[target], axis=1)
        near = np.flatnonzero(apart_m < self.reach_m[target] + self.reach_m[source])
        if len(near):
            score = self.judge(target, source, samples).score(T_target_source[near], SURE)
            result[:, near] = score.overlap, score.violation
        return result

    def all_pairs(
        self,
        targets: Mapping[int, FloatArray],
        sources: Mapping[int, FloatArray],
        T_targets_sources: FloatArray,
        hopeless: float | None = None,
    ) -> Testimony:
        """What every scan of one group says of every scan of another.

        Of a candidate that a single pair refutes by more than is hopeless, the others are not
        asked.

        Args:
            targets: (4, 4) pose of each scan in its group's frame.
            sources: likewise.
            T_targets_sources: (C, 4, 4) candidates for how the groups lie to each other.
            hopeless: what a single pair may contradict by; None for the witness's own.
        """
        most = self.hopeless if hopeless is None else hopeless
        support, excess, worst, closest = np.zeros((4, len(T_targets_sources)))
        witnesses = np.zeros(len(T_targets_sources), dtype=np.int64)
        for a, b, near in self._meetings(targets, sources, T_targets_sources):
            rows = np.flatnonzero(near & (worst <= most))
            if not len(rows):
                continue
            T_a_b = invert(targets[a]) @ T_targets_sources[rows] @ sources[b]
            overlap, violation = self.pair(a, b, T_a_b)
            support[rows] += overlap
            beyond = np.maximum(violation - STRAY_SHARE, 0.0)
            excess[rows] += beyond
            worst[rows] = np.maximum(worst[rows], beyond)
            witnesses[rows] += overlap >= MIN_OVERLAP
            closest[rows] = np.maximum(closest[rows], overlap)
        return Testimony(support, excess, worst, witnesses, closest)

    def _meetings(
        self,
        targets: Mapping[int, FloatArray],
        sources: Mapping[int, FloatArray],
        T_targets_sources: FloatArray,
    ) -> list[tuple[int, int, BoolArray]]:
        """Pairs of scans that may see the same, with (C,) in which candidates; the nearest first,
        which soonest refute a wrong place."""
        firsts, seconds = list(targets), list(sources)
        here_m = np.array(
            [transform_points(targets[a], self.centres_m[a][None])[0] for a in firsts]
        )
        there_m = np.array(
            [transform_points(sources[b], self.centres_m[b][None])[0] for b in seconds]
        )
        moved_m = np.einsum("cij,bj->cbi", T_targets_sources[:, :3, :3], there_m)
        moved_m += T_targets_sources[:, None, :3, 3]
        apart_m = np.linalg.norm(here_m[:, None, None] - np.swapaxes(moved_m, 0, 1)[None], axis=3)
        reach_m = np.add.outer(self.reach_m[firsts], self.reach_m[seconds])
        near = apart_m < reach_m[..., None]
        met = np.argwhere(near.any(axis=2))
        order = np.argsort(apart_m.min(axis=2)[tuple(met.T)], kind="stable")
        return [(firsts[i], seconds[k], near[i, k]) for i, k in met[order]]
