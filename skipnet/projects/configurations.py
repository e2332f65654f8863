"""Configurations: where all scans stand, what agrees in them, and how they are put together."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skipnet.geometry import invert, straightened
from skipnet.projects.groups import Group, Proposals
from skipnet.projects.sameness import same_place
from skipnet.projects.ways import MIN_SUPPORT, PairKey, Standards
from skipnet.projects.witness import LITTLE_OVERLAP, MIN_OVERLAP, STRAY_SHARE, Witness
from skipnet.types import BoolArray, FloatArray, IntArray

SPREAD = 0.7
"""Standard deviation of the logarithm of the factor by which a join counts more or less."""
ALONE = np.eye(4)
"""Where a scan of its own group is."""


@dataclass(frozen=True)
class Configuration:
    """Groups of scans, with what agrees in them."""

    poses: tuple[dict[int, FloatArray], ...]
    """Per group the (4, 4) pose of each scan's own frame, in the group's."""
    shares: dict[PairKey, float]
    """Of each pair of one group of which something agrees, which share of the surfaces."""
    against: dict[PairKey, float]
    """Of each pair of one group that sees the same by how many times the limit it contradicts,
    stray voxels included: where scans stand right next to none do, and few tell alike rooms
    apart."""

    @cached_property
    def merit(self) -> float:
        """How much agrees, less what contradicts: a limit's worth of it outweighs a whole scan.

        Without the last digits, in which sums of another order differ.
        """
        return round(sum(self.shares.values()) - sum(self.against.values()), 6)

    @cached_property
    def groups(self) -> list[Group]:
        """The largest first."""
        made = [
            Group(one, sum(share for key, share in self.shares.items() if key[0] in one))
            for one in self.poses
        ]
        return sorted(made, key=lambda group: (-len(group.poses), group.scans))


@dataclass(frozen=True)
class Edges:
    """E proposals that nothing speaks against, each by itself."""

    ends: IntArray
    """(E, 2) numbers of target and source."""
    T_target_source: FloatArray
    """(E, 4, 4)"""
    weight: FloatArray
    """(E,) how promising each is."""


class Builder:
    """Joins groups by the edges between them."""

    def __init__(self, edges: Edges, witness: Witness, standards: Standards) -> None:
        self._edges = edges
        self.witness = witness
        self._standards = standards
        self._objections: dict[int, tuple[PairKey, tuple[FloatArray, ...]]] = {}
        """Of each edge the pair of scans that objected to it last, which is asked first next time,
        and from which poses it followed how they would lie."""

    def following(self, configuration: Configuration, scan: int) -> BoolArray:
        """(E,) the edges that put a scan where a configuration has it."""
        ends, witness = self._edges.ends, self.witness
        result = np.zeros(len(ends), dtype=bool)
        poses = next(one for one in configuration.poses if scan in one)
        for row in np.flatnonzero((ends == scan).any(axis=1)):
            target, source = ends[row]
            if target in poses and source in poses:
                T = invert(poses[target]) @ poses[source]
                result[row] = same_place(witness, source, T, self._edges.T_target_source[row])
        return result

    def build(
        self,
        start: Configuration,
        rng: np.random.Generator | None,
        without: BoolArray | None = None,
    ) -> Configuration:
        """Join groups by the most promising edge first, as long as nothing objects.

        Args:
            start: what is joined already.
            rng: of the order, None for that of what is most promising.
            without: (E,) edges that are not taken.
        """
        poses = list(start.poses)
        of = np.zeros(1 + max(max(one) for one in poses), dtype=np.int64)
        for number, one in enumerate(poses):
            of[list(one)] = number
        shares, against, weight = dict(start.shares), dict(start.against), self._edges.weight
        if rng is not None:
            weight = weight * np.exp(SPREAD * rng.normal(size=len(weight)))
        ends = self._edges.ends
        is_across = of[ends[:, 0]] != of[ends[:, 1]]
        across = np.flatnonzero(is_across if without is None else is_across & ~without)
        for row in across[np.argsort(-weight[across], kind="stable")]:
            first, second = of[ends[row]]
            if first != second:
                if len(poses[first]) < len(poses[second]):  # the larger group stays where it is
                    first, second = second, first
                found = self._joined(poses[first], poses[second], row)
                if found is not None:
                    moved, agree, contradict = found
                    poses[first] = {**poses[first], **moved}
                    of[list(moved)] = first
                    shares |= agree
                    against |= contradict
        left = tuple(poses[number] for number in np.unique(of[[s for one in poses for s in one]]))
        return Configuration(left, shares, against)

    def _joined(
        self, first: dict[int, FloatArray], second: dict[int, FloatArray], row: int
    ) -> tuple[dict[int, FloatArray], dict[PairKey, float], dict[PairKey, float]] | None:
        """The second group in the first's frame, what agrees across both and what contradicts; None
        if a scan objects, or hardly anything agrees."""
        if self._objects_again(row, first, second):
            return None
        T = self._between(row, first, second)
        moved: dict[int, FloatArray] = {scan: T @ pose for scan, pose in second.items()}
        shares, against, excess, limit = {}, {}, 0.0, self._standards.limit
        for a, b, T_a_b in self.witness.meeting(first, moved):
            overlap, violation = self.witness.about(a, b, T_a_b)
            beyond = max(violation - STRAY_SHARE, 0.0)
            if self._objects(a, b, T_a_b, overlap, beyond):
                self._objections[row] = (a, b), self._lying(row, a, b, first, second)
                return None
            excess += beyond
            if overlap > 0:
                shares[a, b] = overlap
            if violation > 0 and overlap >= MIN_OVERLAP:
                against[a, b] = violation / limit
        support = sum(shares.values())
        if support < MIN_SUPPORT or excess > limit * (support + LITTLE_OVERLAP):
            return None
        return moved, shares, against

    def _objects(self, a: int, b: int, T_a_b: FloatArray, overlap: float, excess: float) -> bool:
        """Whether a pair of scans refutes a join."""
        is_twin = overlap > self._standards.most_overlap
        is_twin = is_twin and not self.witness.same_station(a, b, T_a_b[None])[0]
        return is_twin or excess > self._standards.limit

    def _between(
        self, row: int, first: dict[int, FloatArray], second: dict[int, FloatArray]
    ) -> FloatArray:
        """(4, 4) the second group's frame in the first's, by an edge."""
        (target, source), T_target_source = self._edges.ends[row], self._edges.T_target_source[row]
        if target in second:
            target, source, T_target_source = source, target, invert(T_target_source)
        T = first[target] @ T_target_source @ invert(second[source])
        # Straight, since what rounding adds would double with every inverse of an inverse.
        return straightened(T)

    def _objects_again(
        self, row: int, first: dict[int, FloatArray], second: dict[int, FloatArray]
    ) -> bool:
        """Whether the pair that objected to an edge before does so to this join, too."""
        if row not in self._objections:
            return False
        (a, b), before = self._objections[row]
        if not ((a in first and b in second) or (a in second and b in first)):
            return False
        now = self._lying(row, a, b, first, second)
        if all(map(operator.is_, now, before)):  # nothing has moved
            return True
        T = self._between(row, first, second)
        here, there = (T @ second[one] if one in second else first[one] for one in (a, b))
        T_a_b = invert(here) @ there
        overlap, violation = self.witness.about(a, b, T_a_b)
        objects = self._objects(a, b, T_a_b, overlap, violation - STRAY_SHARE)
        if objects:
            self._objections[row] = (a, b), now
        return objects

    def _lying(
        self, row: int, a: int, b: int, first: dict[int, FloatArray], second: dict[int, FloatArray]
    ) -> tuple[FloatArray, ...]:
        """The poses from which follows how a pair of scans would lie after a join."""
        scans = *self._edges.ends[row].tolist(), a, b
        return tuple(first[scan] if scan in first else second[scan] for scan in scans)


def edges_of(
    proposals: Mapping[PairKey, Proposals], witness: Witness, standards: Standards
) -> Edges:
    """The proposals in which something agrees and next to nothing contradicts."""
    ends: list[PairKey] = []
    T: list[FloatArray] = [np.zeros((0, 4, 4))]
    weight: list[float] = []
    for key, pair in sorted(proposals.items()):
        excess = np.maximum(pair.violation - STRAY_SHARE, 0.0)
        rows = pair.overlap <= standards.most_overlap
        rows |= witness.same_station(*key, pair.T_target_source)
        rows &= (pair.overlap >= MIN_OVERLAP) & (excess <= standards.limit)
        ends += [key] * int(rows.sum())
        T.append(pair.T_target_source[rows])
        weight += (pair.overlap * np.exp(-pair.violation / standards.limit))[rows].tolist()
    stacked = np.array(ends, dtype=np.int64).reshape(-1, 2)
    return Edges(stacked, np.concatenate(T), np.array(weight))


def all_alone(scans: Sequence[int]) -> Configuration:
    """No two scans joined."""
    return Configuration(tuple({scan: ALONE} for scan in scans), {}, {})
