"""What may be wrong with groups: scans that would fit elsewhere, links that stand alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.connected import components, without_bridges
from skipnet.projects.groups import Joiner, PairKey, merit, rivals
from skipnet.projects.motions import rival_split
from skipnet.projects.ways import SAME_VOXELS, Group, Standards, Way
from skipnet.projects.witness import MIN_OVERLAP, leaders
from skipnet.types import FloatArray

LENIENT = Standards(limit=0.0125, rival_support=0.65, severity=1.0, believes_one=True)
"""Where what pairs say by themselves holds throughout: outdoors right poses of real scans
contradict each other by .011."""
STRICT = Standards(limit=0.0018, rival_support=0.4)
"""Where it does not, because much looks alike: right poses of simulated scans that nothing disturbs
stay under .0013, wrong ones in alike rooms reach .002 and more (floors of development seeds)."""
RELIABLE = 0.9
"""Share of the registered pairs that must hold for pairs to be believed by themselves: it is 1.00
in a facade, a kitchen and a turntable, and .08 to .75 in simulated floors of alike rooms."""
CLEARLY_BETTER = 1.1
"""A place that is worth this many times more than the present one is better."""
MAX_ROUNDS = 5
TWIN_OVERLAP = 0.9
"""Where much looks alike, two scans of which more agrees may be of two rooms furnished alike: then
nothing tells which of them is where."""
REMAINING_RIVAL = 0.3
"""In the end a second place with this share of the support leaves a scan in doubt."""


@dataclass(frozen=True)
class Decision:
    """Groups of scans, the largest first, and what is in doubt."""

    groups: list[Group]
    """Those of one scan included."""
    places: Mapping[int, list[FloatArray]]
    """Of every scan in doubt, where it may stand, the likeliest first: (4, 4) poses of its own
    frame in that of the group ``host`` ..."""
    host: Mapping[int, int]
    """... whose lowest scan number this is."""
    reliability: float
    """Share of the registered pairs that hold, of those that could be told."""


class Arbiter:
    """Decides which scans belong together."""

    def __init__(self, joiner: Joiner) -> None:
        self._joiner = joiner

    def decide(self, scans: Iterable[int]) -> Decision:
        """Groups from what pairs proposed, and what is in doubt."""
        scans = list(scans)
        standards = LENIENT
        groups = self._repaired(self._grown(scans, standards), standards)
        reliability = self.reliability(groups)
        if reliability < RELIABLE:
            standards = STRICT
            groups = self._repaired(self._grown(scans, standards), standards)
            reliability = min(self.reliability(groups), reliability)
        for _ in range(MAX_ROUNDS):
            sure = self._undoubted(groups, standards, reliability)
            groups = self._joiner.grow(self._counted(sure), standards)
            if [group.scans for group in groups] == [group.scans for group in sure]:
                break
        groups = self._undoubted(groups, standards, reliability)
        return self._with_places(groups, _final(standards, reliability), reliability)

    def _counted(self, groups: list[Group]) -> list[Group]:
        """The groups with their support, which cutting forgets."""
        witness = self._joiner.witness
        return [
            Group(
                group.poses,
                sum(
                    float(witness.pair(a, b, (invert(group.poses[a]) @ group.poses[b])[None])[0, 0])
                    for a, b in combinations(group.scans, 2)
                ),
            )
            for group in groups
        ]

    def reliability(self, groups: list[Group]) -> float:
        """Share of the registered pairs that hold, of those that can be told; 1 for none."""
        of_scan = {scan: group for group in groups for scan in group.poses}
        held, refuted = 0, 0
        for key, pair in self._joiner.proposals.items():
            if pair.confidence == 0:
                continue
            first, second = of_scan[key[0]], of_scan[key[1]]
            if first is second:
                holds = bool(self._joiner.proposed(first, key)[0])
                held, refuted = held + holds, refuted + (not holds)
            else:
                ways = self._joiner.ways(*sorted((first, second), key=lambda g: g.scans))
                own = [way for way in ways if key in way.voters and way.trust > 0]
                refuted += all(way.contradiction > LENIENT.limit for way in own)
        return held / (held + refuted) if held + refuted else 1.0

    def _grown(self, scans: Iterable[int], standards: Standards) -> list[Group]:
        return self._joiner.grow((Group.single(scan) for scan in scans), standards)

    def _repaired(self, groups: list[Group], standards: Standards) -> list[Group]:
        """Take out scans that may stand wrong, let the others grow, put them back last."""
        suspects: set[int] = set()
        for _ in range(MAX_ROUNDS):
            fresh = {s for group in groups for s in self._suspects(group, standards)} - suspects
            if not fresh:
                break
            suspects |= fresh
            for late in [fresh, suspects, *({scan} for scan in sorted(fresh))]:
                trial = self._regrown(groups, late, standards)
                if merit(trial) > merit(groups) + 1e-6:
                    groups = trial
        return groups

    def _regrown(self, groups: list[Group], late: set[int], standards: Standards) -> list[Group]:
        """The groups anew, some scans put in last; groups that have none of them stay."""
        early = [group for group in groups if not late & set(group.poses)]
        torn = {scan for group in groups if late & set(group.poses) for scan in group.poses}
        early += [Group.single(scan) for scan in torn - late]
        grown = self._joiner.grow(early, standards)
        return self._joiner.grow([*grown, *(Group.single(scan) for scan in late)], standards)

    def _suspects(self, group: Group, standards: Standards) -> list[int]:
        """Scans that fewer than two pairs put where they are, or that fit better elsewhere."""
        if len(group.poses) < 2:
            return []
        return [
            scan
            for scan in group.scans
            if len(self._joiner.voters(group, scan)) < 2 or self._has_better(group, scan, standards)
        ]

    def _has_better(self, group: Group, scan: int, standards: Standards) -> bool:
        here, others = self._places(group, scan)
        return any(way.worth(standards) > CLEARLY_BETTER * here.worth(standards) for way in others)

    def _places(self, group: Group, scan: int) -> tuple[Way, list[Way]]:
        """Where a scan stands among the others of its group, and where else it might."""
        rest, alone = group.without(scan), Group.single(scan)
        T = group.poses[scan]
        said = self._joiner.witness.all_pairs(rest.poses, alone.poses, T[None])
        ways = self._joiner.ways(rest, alone)
        stack = np.concatenate([T[None], *(way.T[None] for way in ways)])
        witness = self._joiner.witness
        size_m = SAME_VOXELS * witness.voxel_size_m
        is_here = leaders(stack, witness.centres_m[scan], size_m)[1:] == 0
        here = Way(
            T,
            self._joiner.voters(group, scan),
            0.0,
            float(said.support[0]),
            float(said.contradiction[0]),
            int(said.witnesses[0]),
        )
        return here, [way for way, same in zip(ways, is_here, strict=True) if not same]

    def _undoubted(
        self, groups: list[Group], standards: Standards, reliability: float
    ) -> list[Group]:
        """The groups without the scans that would fit elsewhere, cut where one link holds them."""
        is_reliable = reliability >= RELIABLE
        final = _final(standards, reliability)
        kept, left = [], list(groups)
        while left:
            group = left.pop()
            sure = [s for s in group.scans if not self._is_torn(group, s, final)]
            if not is_reliable:
                sure = [s for s in sure if s not in self._twins(group)]
            doubtful = set(group.scans) - set(sure)
            kept += [Group.single(scan) for scan in sorted(doubtful)]
            for part in self._parts(group, sure, reliability):
                rest = Group({scan: group.poses[scan] for scan in part})
                split = rival_split(rest, self._joiner, final) if len(part) > 1 else None
                if split is None:
                    kept.append(rest)
                else:
                    left += [Group({scan: rest.poses[scan] for scan in side}) for side in split]
        kept = [group if len(group.poses) > 1 else Group.single(group.scans[0]) for group in kept]
        return sorted(kept, key=lambda group: (-len(group.poses), group.scans))

    def _twins(self, group: Group) -> set[int]:
        """Scans that see the same as another one: of the same room, or of one furnished alike."""
        return {scan for key in self._edges(group, group.scans, TWIN_OVERLAP) for scan in key}

    def _is_torn(self, group: Group, scan: int, standards: Standards) -> bool:
        if len(group.poses) < 3:
            return False
        here, others = self._places(group, scan)
        return len(rivals([here, *others], standards)) > 1

    def _parts(self, group: Group, scans: list[int], reliability: float) -> list[list[int]]:
        """The scans that hang together; where pairs are not reliable, by more than one link."""
        edges = self._edges(group, scans, MIN_OVERLAP)
        if reliability < RELIABLE:
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

    def _with_places(
        self, groups: list[Group], standards: Standards, reliability: float
    ) -> Decision:
        """What is known of the scans that stand alone."""
        places: dict[int, list[FloatArray]] = {}
        host: dict[int, int] = {}
        for lone in [group for group in groups if len(group.poses) == 1]:
            scan = lone.scans[0]
            others = [g for g in groups if len(g.poses) > 1 or g.scans[0] < scan]
            fitting = [
                (group, rivals(self._joiner.ways(group, lone), standards)) for group in others
            ]
            best = max(
                ((ways[0].worth(standards), group, ways) for group, ways in fitting if ways),
                key=lambda option: option[0],
                default=None,
            )
            if best is not None:
                places[scan] = [way.T for way in best[2]]
                host[scan] = best[1].scans[0]
        return Decision(groups, places, host, reliability)


def _final(standards: Standards, reliability: float) -> Standards:
    """What counts as a rival in the end: where pairs are not reliable, more does."""
    if reliability >= RELIABLE:
        return standards
    return replace(standards, rival_support=REMAINING_RIVAL)
