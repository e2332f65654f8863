"""What may be wrong with groups: scans that would fit elsewhere, links that stand alone."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.components import components, without_bridges
from skipnet.projects.groups import (
    SAME_VOXELS,
    Group,
    Joiner,
    PairKey,
    Standards,
    Way,
    rivals,
)
from skipnet.projects.motions import rival_split
from skipnet.projects.witness import MIN_OVERLAP, leaders

TWIN_OVERLAP = 0.9
"""Where much looks alike, two scans of which more agrees may be of two rooms furnished alike: then
nothing tells which of them is where."""
MANY_SCANS = 6
"""Where much looks alike, a group of fewer scans is believed only ..."""
FIRM_WITNESSES = 3
"""... of scans that overlap with this many others of it."""
REMAINING_RIVAL = 0.3
"""In the end a second place with this share of the support leaves a scan in doubt."""


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
        """The groups without the scans that would fit elsewhere, cut where one link holds them."""
        kept, left = [], list(groups)
        while left:
            group = left.pop()
            sure = [s for s in group.scans if not self._is_torn(group, s)]
            if not self._is_reliable:
                sure = [s for s in sure if s not in self._twins(group)]
            doubtful = set(group.scans) - set(sure)
            kept += [Group.single(scan) for scan in sorted(doubtful)]
            for part in self._parts(group, sure):
                rest = Group({scan: group.poses[scan] for scan in part})
                split = rival_split(rest, self._joiner, self.standards) if len(part) > 1 else None
                if split is None:
                    kept.append(rest)
                else:
                    left += [Group({scan: rest.poses[scan] for scan in side}) for side in split]
        if not self._is_reliable:
            kept = [part for group in kept for part in self._firm(group)]
        kept = [group if len(group.poses) > 1 else Group.single(group.scans[0]) for group in kept]
        return sorted(kept, key=lambda group: (-len(group.poses), group.scans))

    def _firm(self, group: Group) -> list[Group]:
        """A group of few scans without those of which too few others say anything.

        Few scans see too little of the place to contradict one that stands wrong.
        """
        if not 1 < len(group.poses) < MANY_SCANS:
            return [group]
        edges = self._edges(group, group.scans, MIN_OVERLAP)
        loose = [s for s in group.scans if sum(s in key for key in edges) < FIRM_WITNESSES]
        rest = Group({s: T for s, T in group.poses.items() if s not in loose})
        if not loose:
            return [group]
        return [Group.single(scan) for scan in loose] + (self._firm(rest) if rest.poses else [])

    def _twins(self, group: Group) -> set[int]:
        """Scans that see the same as another one: of the same room, or of one furnished alike."""
        return {scan for key in self._edges(group, group.scans, TWIN_OVERLAP) for scan in key}

    def _is_torn(self, group: Group, scan: int) -> bool:
        if len(group.poses) < 3:
            return False
        here, others = places(group, scan, self._joiner)
        return len(rivals([here, *others], self.standards)) > 1

    def _parts(self, group: Group, scans: list[int]) -> list[list[int]]:
        """The scans that hang together; where pairs are not reliable, by more than one link."""
        edges = self._edges(group, scans, MIN_OVERLAP)
        if not self._is_reliable:
            edges = without_bridges(edges)
        return components(scans, edges)

    def _edges(self, group: Group, scans: list[int], least: float) -> list[PairKey]:
        """Pairs of which so much agrees."""
        return [
            (a, b)
            for a, b in combinations(scans, 2)
            if self._joiner.witness.pair(a, b, (invert(group.poses[a]) @ group.poses[b])[None])[0]
            >= least
        ]


def places(group: Group, scan: int, joiner: Joiner) -> tuple[Way, list[Way]]:
    """Where a scan stands among the others of its group, and where else it might."""
    rest, alone = group.without(scan), Group.single(scan)
    T = group.poses[scan]
    said = joiner.witness.all_pairs(rest.poses, alone.poses, T[None])
    ways = joiner.ways(rest, alone)
    stack = np.concatenate([T[None], *(way.T[None] for way in ways)])
    witness = joiner.witness
    size_m = SAME_VOXELS * witness.voxel_size_m
    is_here = leaders(stack, witness.centres_m[scan], size_m)[1:] == 0
    here = Way(
        T,
        joiner.voters(group, scan),
        0.0,
        float(said.support[0]),
        float(said.contradiction[0]),
        int(said.witnesses[0]),
    )
    return here, [way for way, same in zip(ways, is_here, strict=True) if not same]
