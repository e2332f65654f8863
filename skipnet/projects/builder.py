"""Configurations are put together: groups are joined by edges, as long as no scan objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, straightened
from skipnet.projects.configurations import ALONE, Configuration
from skipnet.projects.groups import Proposals
from skipnet.projects.sameness import same_place
from skipnet.projects.testimony import LITTLE_OVERLAP
from skipnet.projects.ways import MIN_SUPPORT, PairKey, Standards
from skipnet.projects.witness import MIN_OVERLAP, STRAY_SHARE, Witness
from skipnet.types import BoolArray, FloatArray, IntArray

SPREAD = 0.7
"""Standard deviation of the logarithm of the factor by which a join counts more or less."""
REMEMBERED = 6
"""Pairs of scans that objected to an edge, which are asked first next time."""


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
        self._objected = np.full((len(edges.ends), REMEMBERED, 2), -1)
        """Pairs of scans that objected to each edge, the latest first: most do so again, and all
        are asked at once. -1 for none."""

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
        parts = _Parts(start)
        weight, ends = self._edges.weight, self._edges.ends
        if rng is not None:
            weight = weight * np.exp(SPREAD * rng.normal(size=len(weight)))
        is_across = parts.of[ends[:, 0]] != parts.of[ends[:, 1]]
        across = np.flatnonzero(is_across if without is None else is_across & ~without)
        rows = across[np.argsort(-weight[across], kind="stable")]
        refused = self._refused(rows, parts, np.ones(len(parts.of), dtype=bool))
        for place, row in enumerate(rows):
            first, second = parts.of[ends[row]]
            if refused[place] or first == second:
                continue
            if len(parts.scans[first]) < len(parts.scans[second]):  # the larger stays where it is
                first, second = second, first
            came = parts.of == second
            if self._is_joined(parts, first, second, row):
                # Those who came may object, and be objected to; the others have been asked.
                of = parts.of[ends[rows[place + 1 :]]]
                later = np.flatnonzero((of == first).any(axis=1) & (of[:, 0] != of[:, 1]))
                later = later[~refused[later + place + 1]] + place + 1
                refused[later] = self._refused(rows[later], parts, came)
        return parts.configuration()

    def _is_joined(self, parts: _Parts, first: int, second: int, row: int) -> bool:
        """Join two groups by an edge, unless a scan objects, or hardly anything agrees."""
        target, source = self._edges.ends[row]
        T = parts.T[target] @ self._edges.T_target_source[row] @ invert(parts.T[source])
        # Straight, since what rounding adds would double with every inverse of an inverse.
        T = straightened(T if parts.of[target] == first else invert(T))
        moved = T @ parts.T[parts.scans[second]]
        groups = parts.scans[first], parts.scans[second]
        a, b, T_a_b = self.witness.meeting(groups[0], parts.T[groups[0]], groups[1], moved)
        shares, against, excess, limit = {}, {}, 0.0, self._standards.limit
        for i, (overlap, violation) in enumerate(self.witness.about(a, b, T_a_b)):
            objects = violation - STRAY_SHARE > limit
            if overlap > self._standards.most_overlap:
                objects |= not self.witness.same_station(a[i], b[i], T_a_b[i : i + 1])[0]
            if objects:
                self._objected[row] = np.roll(self._objected[row], 1, axis=0)
                self._objected[row, 0] = a[i], b[i]
                return False
            excess += max(violation - STRAY_SHARE, 0.0)
            key = int(a[i]), int(b[i])
            if overlap > 0:
                shares[key] = overlap
            if violation > 0 and overlap >= MIN_OVERLAP:
                against[key] = violation / limit
        support = sum(shares.values())
        if support < MIN_SUPPORT or excess > limit * (support + LITTLE_OVERLAP):
            return False
        parts.join(first, second, moved)
        parts.shares |= shares
        parts.against |= against
        return True

    def _objects(
        self,
        a: IntArray,
        b: IntArray,
        T_a_b: FloatArray,
        overlap: FloatArray,
        violation: FloatArray,
    ) -> BoolArray:
        """(P,) whether pairs of scans refute a join."""
        is_twin = overlap > self._standards.most_overlap
        if is_twin.any():
            is_twin &= ~self.witness.same_station(a, b, T_a_b)
        objects: BoolArray = is_twin | (violation - STRAY_SHARE > self._standards.limit)
        return objects

    def _refused(self, rows: IntArray, parts: _Parts, came: BoolArray) -> BoolArray:
        """(R,) whether a pair that objected to an edge before does so to this join, too; where none
        of (S,) scans that came is part of it nobody is asked again."""
        refused = np.zeros(len(rows), dtype=bool)
        pairs = self._objected[rows]
        ends = self._edges.ends[rows]
        of_ends = parts.of[ends][:, None]
        of_pairs = np.where(pairs >= 0, parts.of[pairs], -1)
        applies = (of_pairs == of_ends).all(axis=2) | (of_pairs == of_ends[:, :, ::-1]).all(axis=2)
        place = np.cumsum(applies, axis=1)
        applies &= came[ends].any(axis=1, keepdims=True) | came[pairs].any(axis=2)
        for asked in (applies & (place == 1), applies & (place > 1)):  # mostly one is enough
            at, which = np.nonzero(asked & ~refused[:, None])
            if len(at):
                objects = self._object_again(rows[at], pairs[at, which], parts)
                refused[at[objects]] = True
        return refused

    def _object_again(self, rows: IntArray, pairs: IntArray, parts: _Parts) -> BoolArray:
        """(R,) whether (R, 2) pairs of scans refute the joins by (R,) edges."""
        (a, b), (target, source) = pairs.T, self._edges.ends[rows].T
        T = parts.T[target] @ self._edges.T_target_source[rows] @ invert(parts.T[source])
        is_straight = parts.of[a] == parts.of[target]
        T = np.where(is_straight[:, None, None], T, invert(T))
        T_a_b = invert(parts.T[a]) @ T @ parts.T[b]
        overlap, violation = np.array(list(self.witness.about(a, b, T_a_b))).T
        return self._objects(a, b, T_a_b, overlap, violation)


class _Parts:
    """Groups as they are joined."""

    def __init__(self, start: Configuration) -> None:
        count = 1 + max(max(one) for one in start.poses)
        self.T = np.tile(ALONE, (count, 1, 1))
        """(S, 4, 4) the pose of each scan's own frame in its group's."""
        self.of = np.zeros(count, dtype=np.int64)
        """(S,) number of each scan's group."""
        self.scans = [list(one) for one in start.poses]
        for number, one in enumerate(start.poses):
            self.T[list(one)] = list(one.values())
            self.of[list(one)] = number
        self.shares, self.against = dict(start.shares), dict(start.against)

    def join(self, first: int, second: int, moved: FloatArray) -> None:
        """Put the second group's scans into the first one, with (K, 4, 4) poses there."""
        self.T[self.scans[second]] = moved
        self.of[self.scans[second]] = first
        self.scans[first] = self.scans[first] + self.scans[second]
        self.scans[second] = []

    def configuration(self) -> Configuration:
        """What has become of them."""
        poses = tuple({scan: self.T[scan] for scan in group} for group in self.scans if group)
        return Configuration(poses, self.shares, self.against)


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
