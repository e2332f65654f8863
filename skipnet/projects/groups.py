"""Which links to believe: groups of scans grow as long as no pair of their scans objects.

Two groups are joined only where every pair of scans that the join implies finds next to no
contradiction, and where no other way to join them explains the scans about as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.sameness import SAME_VOXELS, leaders, same_place
from skipnet.projects.testimony import Testimony
from skipnet.projects.ways import PairKey, Standards, Way, rivals
from skipnet.projects.witness import Witness
from skipnet.types import BoolArray, FloatArray

MAX_WAYS = 12
"""Ways to join two groups that are looked at: those of which most agrees in the pairs' own eyes."""
MIN_UNTRUSTED_SUPPORT = 0.15
"""... and one that a single pair proposes which did not register needs this much ..."""
MIN_WITNESSES = 2
"""... and this many pairs of which some agrees."""
_OWN_VIOLATION = 0.01
"""Of a proposal in its own pair, which leaves 37 % of its weight."""


@dataclass(frozen=True)
class Proposals:
    """What searching one pair of scans proposed, the answer first."""

    T_target_source: FloatArray
    """(H, 4, 4) between the scans' own frames."""
    overlap: FloatArray
    """(H,) share of the surfaces that agree."""
    violation: FloatArray
    """(H,) share that contradicts seen free space."""
    confidence: float
    """Of the first, if it is registered; else 0."""

    @property
    def answer(self) -> Proposals:
        """The first alone."""
        T, overlap, violation = self.T_target_source[:1], self.overlap[:1], self.violation[:1]
        return Proposals(T, overlap, violation, self.confidence)


@dataclass(frozen=True)
class Group:
    """Scans whose relative poses are decided."""

    poses: Mapping[int, FloatArray]
    """(4, 4) of each scan's own frame, in the group's."""
    support: float = 0.0
    """Sum over all pairs of scans of the share of surfaces that agree."""

    @cached_property
    def scans(self) -> list[int]:
        """In ascending order."""
        return sorted(self.poses)

    def without(self, scan: int) -> Group:
        """The others where they are; the support is not known anew."""
        return Group({s: T for s, T in self.poses.items() if s != scan})

    @staticmethod
    def single(scan: int) -> Group:
        """A scan alone, in its own frame."""
        return Group({scan: np.eye(4)})


class Joiner:
    """Joins groups by the proposals of pairs of scans."""

    def __init__(self, proposals: Mapping[PairKey, Proposals], witness: Witness) -> None:
        self.proposals = proposals
        self.witness = witness
        self._known: dict[tuple[bytes, bytes, float], list[Way]] = {}

    def grow(self, groups: Iterable[Group], standards: Standards) -> list[Group]:
        """Join groups, the best founded join first, until no join is left that nobody objects to.

        The order of the groups does not matter: of equal joins the one of the lowest numbers wins.

        Args:
            groups: to begin with.
            standards: what a join must fulfil.
        """
        left = {group.scans[0]: group for group in groups}
        open_joins = {key: self.decided(*_both(left, key), standards) for key in _pairs(left)}
        while True:
            ranked = [
                (way.rank(standards), -key[0], -key[1])
                for key, way in open_joins.items()
                if way is not None
            ]
            if not ranked:
                return sorted(left.values(), key=lambda group: (-len(group.poses), group.scans))
            key = -max(ranked)[1], -max(ranked)[2]
            way = open_joins[key]
            assert way is not None
            joined = join(*_both(left, key), way)
            del left[key[1]]
            left[key[0]] = joined
            open_joins = {k: way for k, way in open_joins.items() if not {*k} & {*key}} | {
                k: self.decided(*_both(left, k), standards) for k in _pairs(left) if key[0] in k
            }

    def decided(self, first: Group, second: Group, standards: Standards) -> Way | None:
        """The one way to join two groups, if there is one."""
        fitting = rivals(self.ways(first, second), standards)
        if len(fitting) != 1:
            return None
        way = fitting[0]
        if standards.least_trust > 0:
            return way if way.trust >= standards.least_trust else None
        founded = len(way.voters) > 1 or way.trust > 0
        if min(len(first.poses), len(second.poses)) == 1 and not standards.believes_one:
            founded |= way.witnesses >= MIN_WITNESSES and way.support >= MIN_UNTRUSTED_SUPPORT
        elif not standards.believes_one:
            founded = len(way.voters) > 1
        return way if founded else None

    def ways(self, first: Group, second: Group) -> list[Way]:
        """Distinct ways to join two groups, with what all pairs of scans say of each."""
        key = _signature(first), _signature(second), self.witness.hopeless
        if key not in self._known:
            self._known[key] = self._find_ways(first, second)
        return self._known[key]

    def overlaps(self, group: Group) -> dict[PairKey, float]:
        """Of each pair of a group the share of their surfaces that agrees."""
        found = {}
        for a, b in combinations(group.scans, 2):
            T_a_b = invert(group.poses[a]) @ group.poses[b]
            found[a, b] = float(self.witness.pair(a, b, T_a_b[None])[0, 0])
        return found

    def voters(self, group: Group, scan: int) -> frozenset[PairKey]:
        """The pairs that propose the place that a scan has in its group."""
        keys = [(min(scan, other), max(scan, other)) for other in group.scans if other != scan]
        return frozenset(key for key in keys if self.proposed(group, key).any())

    def proposed(self, group: Group, key: PairKey) -> BoolArray:
        """(H,) which proposals of a pair of the group put it where it is."""
        if key not in self.proposals:
            return np.zeros(0, dtype=bool)
        T = invert(group.poses[key[0]]) @ group.poses[key[1]]
        return same_place(self.witness, key[1], T, self.proposals[key].T_target_source)

    def holds(
        self, key: PairKey, group_of: Mapping[int, Group], standards: Standards
    ) -> bool | None:
        """Whether a registered pair's answer holds; None if it may join its scans' groups."""
        first, second = group_of[key[0]], group_of[key[1]]
        if first is second:
            return bool(self.proposed(first, key)[0])
        T, limit = self.proposals[key].T_target_source[0], standards.limit
        T_first_second = first.poses[key[0]] @ T @ invert(second.poses[key[1]])
        said = self.witness.all_pairs(first.poses, second.poses, T_first_second[None], limit)
        return False if said.contradiction[0] > limit else None

    def _find_ways(self, first: Group, second: Group) -> list[Way]:
        found = [
            self._across(key, first.poses[a], second.poses[b], is_turned=a > b)
            for a in first.scans
            for b in second.scans
            if (key := (min(a, b), max(a, b))) in self.proposals
        ]
        if not found:
            return []
        T = np.concatenate([T for T, *_ in found])
        trust = np.concatenate([trust for _, trust, *_ in found])
        weight = np.concatenate([weight for *_, weight, _ in found])
        voter = np.array([key for T, *_, key in found for _ in T])
        order = np.argsort(-weight, kind="stable")
        T, trust, weight, voter = T[order], trust[order], weight[order], voter[order]
        leader = leaders(T, self._centre_m(second), SAME_VOXELS * self.witness.voxel_size_m)
        rows = np.unique(leader)
        total = np.array([weight[leader == row].sum() for row in rows])
        rows = rows[np.argsort(-total, kind="stable")[:MAX_WAYS]]
        said = self.witness.all_pairs(first.poses, second.poses, T[rows])
        return [
            _way(T[row], voter[leader == row].tolist(), float(trust[leader == row].max()), said, n)
            for n, row in enumerate(rows)
        ]

    def _across(
        self, key: PairKey, T_first_a: FloatArray, T_second_b: FloatArray, is_turned: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray, PairKey]:
        """Poses of the second group in the first's frame that one pair proposes, with trusts,
        weights, and the pair."""
        pair = self.proposals[key]
        T_a_b = invert(pair.T_target_source) if is_turned else pair.T_target_source
        trust = np.zeros(len(T_a_b))
        trust[:1] = pair.confidence
        weight = pair.overlap * np.exp(-pair.violation / _OWN_VIOLATION)
        return T_first_a @ T_a_b @ invert(T_second_b), trust, weight, key

    def _centre_m(self, group: Group) -> FloatArray:
        centres_m = [
            group.poses[scan][:3, :3] @ self.witness.centres_m[scan] + group.poses[scan][:3, 3]
            for scan in group.scans
        ]
        centre_m: FloatArray = np.mean(centres_m, axis=0)
        return centre_m


def join(first: Group, second: Group, way: Way) -> Group:
    """Both groups as one, in the first one's frame."""
    moved = {scan: way.T @ T for scan, T in second.poses.items()}
    return Group({**first.poses, **moved}, first.support + second.support + way.support)


def in_order(first: Group, second: Group) -> tuple[Group, Group]:
    """Two groups as the joiner takes them: by their lowest scan numbers."""
    return (first, second) if first.scans <= second.scans else (second, first)


def merit(groups: Iterable[Group]) -> float:
    """How much of the scans agrees in all groups."""
    return sum(group.support for group in groups)


def _way(T: FloatArray, voters: list[list[int]], trust: float, said: Testimony, row: int) -> Way:
    return Way(
        T=T,
        voters=frozenset((target, source) for target, source in voters),
        trust=trust,
        support=float(said.support[row]),
        contradiction=float(said.contradiction[row]),
        witnesses=int(said.witnesses[row]),
        closest=float(said.closest[row]),
    )


def _pairs(left: Mapping[int, Group]) -> list[tuple[int, int]]:
    return list(combinations(sorted(left), 2))


def _both(left: Mapping[int, Group], key: tuple[int, int]) -> tuple[Group, Group]:
    return left[key[0]], left[key[1]]


def _signature(group: Group) -> bytes:
    return b"".join(scan.to_bytes(4, "big") + group.poses[scan].tobytes() for scan in group.scans)
