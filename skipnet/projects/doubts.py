"""What may be wrong with groups: scans that would fit elsewhere, links that stand alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.components import components
from skipnet.projects.exchanges import exchanged, places
from skipnet.projects.groups import Group, Joiner, in_order
from skipnet.projects.motions import rival_split
from skipnet.projects.ways import MOST_OVERLAP, PairKey, Standards, Way, rivals
from skipnet.projects.witness import MIN_OVERLAP, STRAY_SHARE
from skipnet.types import FloatArray

MOST_OF_A_BUILDING = 0.45
"""Where much looks alike, a group with less than this share of all scans is believed only ..."""
FIRM_WITNESSES = 3
"""... of scans that overlap with this many others of it: where the scan that belongs there is
missing, another may stand in its place."""
REMAINING_RIVAL = 0.5
"""In the end a second place with this share of the support leaves a scan in doubt, be it in another
group."""


class Doubts:
    """Looks groups over once they have grown."""

    def __init__(self, joiner: Joiner, standards: Standards, is_reliable: bool) -> None:
        """Prepare to look.

        Args:
            joiner: knows what pairs proposed.
            standards: by which the groups grew.
            is_reliable: whether pairs can be believed by themselves; else more counts as a rival.
        """
        self._joiner = joiner
        self._is_reliable = is_reliable
        least = standards.rival_support if is_reliable else REMAINING_RIVAL
        self.standards = replace(standards, rival_support=least)

    def sure_parts(self, groups: list[Group]) -> list[Group]:
        """The groups without the scans that would fit elsewhere, in parts that cannot be moved
        against each other."""
        kept, left = [], [self._sure(group, groups) for group in groups]
        kept += [
            Group.single(s)
            for g, rest in zip(groups, left, strict=True)
            for s in g.poses
            if s not in rest.poses
        ]
        while left:
            group = left.pop()
            for part in components(group.scans, self._edges(group)):
                rest = Group({scan: group.poses[scan] for scan in part})
                split = rival_split(rest, self._joiner, self.standards) if len(part) > 1 else None
                if split is None:
                    kept.append(rest)
                else:
                    left += [Group({scan: rest.poses[scan] for scan in side}) for side in split]
        if not self._is_reliable:
            least = MOST_OF_A_BUILDING * sum(len(group.poses) for group in groups)
            kept = [part for group in kept for part in self._firm(group, least)]
        kept = [group if len(group.poses) > 1 else Group.single(group.scans[0]) for group in kept]
        return sorted(kept, key=lambda group: (-len(group.poses), group.scans))

    def _firm(self, group: Group, least: float) -> list[Group]:
        """A group of few scans without those of which too few others say anything."""
        if not 1 < len(group.poses) < least:
            return [group]
        edges = self._edges(group)
        loose = [s for s in group.scans if sum(s in key for key in edges) < FIRM_WITNESSES]
        rest = Group({s: T for s, T in group.poses.items() if s not in loose})
        if not loose:
            return [group]
        return [Group.single(s) for s in loose] + (self._firm(rest, least) if rest.poses else [])

    def _sure(self, group: Group, groups: list[Group]) -> Group:
        """A group without the scans that would fit elsewhere."""
        others = [g for g in groups if g is not group and len(g.poses) > 1]
        sure = [s for s in group.scans if not self._is_torn(group, s, others)]
        sure = [s for s in sure if not self._has_twin(group, s)]
        if not self._is_reliable:
            moved = exchanged(group, self._joiner, self.standards)
            sure = [s for s in sure if s not in moved]
        return Group({scan: group.poses[scan] for scan in sure})

    def _is_torn(self, group: Group, scan: int, groups: list[Group]) -> bool:
        if len(group.poses) < 3:
            return False
        here, others = places(group, scan, self._joiner)
        if not self._is_reliable:
            others += [way for g in groups for way in self._elsewhere(group, scan, g)]
        return len(rivals([here, *others], self.standards)) > 1

    def _elsewhere(self, group: Group, scan: int, other: Group) -> list[Way]:
        """Ways of a scan into another group, but for those by which both groups go together."""
        ways = self._joiner.ways(*in_order(other, Group.single(scan)))
        is_second = other.scans[0] < scan
        found = []
        for way in ways:
            T_other_scan = way.T if is_second else invert(way.T)
            T_group_other = group.poses[scan] @ invert(T_other_scan)
            rest = group.without(scan)
            said = self._joiner.witness.all_pairs(rest.poses, other.poses, T_group_other[None])
            if said.contradiction[0] > self.standards.limit:
                found.append(way)
        return found

    def _has_twin(self, group: Group, scan: int) -> bool:
        """Whether another scan sees the same and might stand here instead of this one."""
        limit = self.standards.limit
        for key, pair in self._joiner.proposals.items():
            same = (pair.overlap > MOST_OVERLAP) & (pair.violation - STRAY_SHARE <= limit)
            if scan in key and same.any():
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
        """Pairs that see enough of the same."""
        overlaps = self._joiner.overlaps(group)
        return [key for key, overlap in overlaps.items() if overlap >= MIN_OVERLAP]
