"""What may be wrong with groups: scans that would fit elsewhere, links that stand alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.assembly import numbered
from skipnet.projects.components import components
from skipnet.projects.firmness import FIRM_WITNESSES, Firmness, Telling, confidence
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.motions import rival_split
from skipnet.projects.places import places
from skipnet.projects.ways import MOST_OVERLAP, PairKey, Standards, rivals
from skipnet.projects.witness import MIN_OVERLAP, STRAY_SHARE
from skipnet.registration.result import Registration
from skipnet.types import FloatArray, Status

SURE_PAIR = 0.98
"""Confidence of a pair of narrow views that joins them. Of camera views of simulated kitchens, most
of which share nothing, wrong pairs that registered had up to 0.977, seven in ten of the right ones
more."""
ASKED_PER_JOIN = 2
"""Pairs that are asked whether two parts belong together as they lie."""
REMAINING_RIVAL = 0.5
"""Where much looks alike, a place with this share of another one's support is as good."""


class Doubts:
    """Looks groups over once they have grown."""

    def __init__(self, joiner: Joiner, standards: Standards, holds: bool, telling: Telling) -> None:
        """Prepare to look.

        Args:
            joiner: knows what pairs proposed.
            standards: by which the groups grew.
            holds: whether what pairs say by themselves holds; where it does not, a scan is believed
                only if others of its group say so, and no twin might stand in its place.
            telling: asked of scans of which others say too little.
        """
        self._joiner = joiner
        self._firmness = Firmness(joiner, holds, telling)
        self._holds = holds
        self.unsure: dict[PairKey, FloatArray] = {}
        """Pairs whose word would settle whether parts that came apart belong together, and (4, 4)
        the pose that they would have."""
        least = standards.rival_support if standards.believes_one else REMAINING_RIVAL
        self.standards = replace(standards, rival_support=least)

    def sure_parts(self, groups: list[Group]) -> list[Group]:
        """The groups without the scans that would fit elsewhere, in parts that cannot be moved
        against each other."""
        group_of = {scan: group for group in groups for scan in group.poses}
        kept, left = [], [self._sure(group, group_of) for group in groups]
        kept += [
            Group.single(s)
            for g, rest in zip(groups, left, strict=True)
            for s in g.poses
            if s not in rest.poses
        ]
        while left:
            group = left.pop()
            parts = components(group.scans, self._edges(group))
            self._note_unsure(group, parts)
            for part in parts:
                rest = Group({scan: group.poses[scan] for scan in part})
                split = self._split(rest)
                if split is None:
                    kept.append(rest)
                else:
                    left += [Group({scan: rest.poses[scan] for scan in side}) for side in split]
        if not self.standards.believes_one:
            kept = [part for group in kept for part in self._firmness.parts(group)]
        kept = [group if len(group.poses) > 1 else Group.single(group.scans[0]) for group in kept]
        return sorted(kept, key=lambda group: (-len(group.poses), group.scans))

    def _split(self, group: Group) -> tuple[list[int], list[int]] | None:
        """Two parts that can be laid against each other in another way; where pairs are not
        believed, the search for configurations has asked."""
        if len(group.poses) < 2 or not self.standards.believes_one:
            return None
        return rival_split(group, self._joiner, self.standards)

    def _sure(self, group: Group, group_of: Mapping[int, Group]) -> Group:
        """A group without the scans that would fit elsewhere."""
        sure = group.scans
        if self.standards.believes_one:
            sure = [s for s in sure if not self._is_torn(group, s)]
            sure = [s for s in sure if not self._is_contested(s, group_of)]
        elif not self._holds:
            sure = [s for s in sure if not self._has_twin(group, s)]
        return Group({scan: group.poses[scan] for scan in sure})

    def _is_torn(self, group: Group, scan: int) -> bool:
        if len(group.poses) < 3:
            return False
        here, others = places(group, scan, self._joiner)
        return len(rivals([here, *others], self.standards)) > 1

    def _is_contested(self, scan: int, group_of: Mapping[int, Group]) -> bool:
        """Whether a pair that is sure by itself is refuted, and few such pairs hold the scan, whose
        own free space would not tell."""
        if self._joiner.witness.sees_all_round(scan):
            return False
        words = [
            self._joiner.holds(key, group_of, self.standards)
            for key, pair in self._joiner.proposals.items()
            if scan in key and pair.confidence >= SURE_PAIR
        ]
        return False in words and words.count(True) < FIRM_WITNESSES

    def _has_twin(self, group: Group, scan: int) -> bool:
        """Whether another scan sees the same and might stand here instead of this one."""
        limit = self.standards.limit
        for key, pair in self._joiner.proposals.items():
            if scan not in key:
                continue
            same = (pair.overlap > MOST_OVERLAP) & (pair.violation - STRAY_SHARE <= limit)
            same &= ~self._joiner.witness.same_station(*key, pair.T_target_source)
            if same.any():
                T = pair.T_target_source[np.argmax(same)]
                T_scan_twin = T if key[0] == scan else invert(T)
                if self._may_swap(group, scan, sum(key) - scan, T_scan_twin):
                    return True
        return False

    def _may_swap(self, group: Group, scan: int, twin: int, T_scan_twin: FloatArray) -> bool:
        """Whether nothing speaks against a scan and its twin in each other's places."""
        rest = group.without(scan).without(twin)
        if twin not in group.poses or not rest.poses:
            return True
        swapped = {
            scan: group.poses[twin] @ invert(T_scan_twin),
            twin: group.poses[scan] @ T_scan_twin,
        }
        pair = {s: group.poses[s] for s in (scan, twin)}
        said = [
            self._joiner.witness.all_pairs(rest.poses, p, np.eye(4)[None]) for p in (pair, swapped)
        ]
        now, then = (one.support[0] for one in said)
        limit = self.standards.limit
        return bool(
            said[1].contradiction[0] <= limit and then >= self.standards.rival_support * now
        )

    def _edges(self, group: Group) -> list[PairKey]:
        """Pairs that see enough of the same, if one of them would see that it cannot be so: two
        narrow views agree by chance on walls and floors, so their pair must be sure by itself."""
        all_round = {scan for scan in group.poses if self._joiner.witness.sees_all_round(scan)}
        return [
            key
            for key, overlap in self._joiner.overlaps(group).items()
            if overlap >= MIN_OVERLAP
            and (all_round & set(key) or confidence(self._joiner, group, key) >= SURE_PAIR)
        ]

    def _note_unsure(self, group: Group, parts: list[list[int]]) -> None:
        """Keep which pairs across the parts of a group agree most."""
        part_of = numbered(parts)
        across: dict[tuple[int, int], list[tuple[float, PairKey]]] = {}
        for (a, b), overlap in self._joiner.overlaps(group).items():
            if part_of[a] != part_of[b] and overlap >= MIN_OVERLAP:
                ends = min(part_of[a], part_of[b]), max(part_of[a], part_of[b])
                across.setdefault(ends, []).append((-overlap, (a, b)))
        for pairs in across.values():
            for _, (a, b) in sorted(pairs)[:ASKED_PER_JOIN]:
                self.unsure[a, b] = invert(group.poses[a]) @ group.poses[b]


def is_sure(result: Registration) -> bool:
    """Whether the word of a pair of narrow views is enough."""
    return result.status is Status.REGISTERED and result.confidence >= SURE_PAIR
