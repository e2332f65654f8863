"""Who belongs together: groups grow or are searched for, and are looked over."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.alternatives import common_parts, in_parts
from skipnet.projects.assembly import numbered
from skipnet.projects.components import components
from skipnet.projects.configurations import Kept
from skipnet.projects.decision import Decision
from skipnet.projects.doubts import SURE_PAIR, Doubts
from skipnet.projects.firmness import Telling
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.orders import configurations, first_configuration
from skipnet.projects.repairs import repaired
from skipnet.projects.tightening import Settle, tightened
from skipnet.projects.ways import MOST_OVERLAP, Standards, rivals
from skipnet.types import FloatArray

LENIENT = Standards(limit=0.0125, rival_support=0.65, severity=1.0, believes_one=True)
"""Where what pairs say by themselves holds throughout: outdoors right poses of real scans
contradict each other by .011."""
BUSY = replace(LENIENT, limit=0.03)
"""Where leaves and passers-by contradict more, and all that is registered holds nevertheless.
Chosen on one facade, whose right pairs contradict by up to .03."""
STRICT = Standards(limit=0.001, rival_support=0.6)
"""Where it does not, because much looks alike: right poses of simulated scans that nothing disturbs
stay under .0008, wrong ones in alike rooms reach .002 and more (floors of development seeds)."""
NOISE = 5.0
"""Where even the best registered pairs contradict, as leaves and passers-by make them, this many
times as much is allowed, up to the lenient limit."""
BEST_SHARE = 0.1
"""Of the registered pairs; most of the others may be wrong."""
RELIABLE = 0.9
"""Share of the registered pairs that must hold for pairs to be believed by themselves: it is 1.00
in a facade, a kitchen and a turntable, and .08 to .75 in most simulated floors of alike rooms. And
they must make a loop for every two scans: a floor of which few pairs hold is no facade."""
MOSTLY_ALL_ROUND = 0.5
"""If so many scans see all round, free space tells places apart. Narrow views and small things fit
on much that they are not part of: there the pairs' own word is all there is, ..."""
LEAST_RELIABLE = 0.75
"""... if so many of them hold."""
SAME_PLACE_LIMIT = 0.003
"""Two scans that share more than strict standards allow stand in one place and see the same free
space. Where they contradict by more than this nevertheless, they are of two rooms that look alike,
and pairs cannot be believed by themselves. Alike rooms laid on each other contradict by .006 to .03
(development seeds), a turntable's neighbours by nothing."""
FEW_PLACED = 0.5
"""Where so few of the scans find a place ..."""
MORE = 4.0
"""... they are looked at once more, and so many times more may contradict: each scan may have some
people in it who stand nowhere in the others. Of six floors of 12 with one to three in each scan
(development seeds) none, 4 and none were placed on three, and 11, 9 and 4 with this, none wrongly;
on the others it changed nothing."""
HOPELESS = 4.0
"""A place that one pair refutes by so many limits is not looked at any further."""
MAX_ROUNDS = 5


Known = dict[Standards, Kept]
"""What was found by which standards, the best first."""


class Arbiter:
    """Decides which scans belong together."""

    def __init__(
        self, joiner: Joiner, settle: Settle, telling: Telling, known: Known | None = None
    ) -> None:
        """Prepare to decide.

        Args:
            joiner: knows what pairs proposed.
            settle: aligns the scans of a group jointly.
            telling: asked of scans of which others say too little.
            known: what was found when less was proposed, and what is found now.
        """
        self._joiner = joiner
        self._telling = telling
        self._known = {} if known is None else known
        self._settle = settle

    def decide(self, scans: Iterable[int]) -> Decision:
        """Groups from what pairs proposed, and what is in doubt."""
        scans = list(scans)
        groups, standards, holds = self._decided(scans)
        decision = self._decision(groups, standards, holds)
        if not standards.believes_one and decision.placed < FEW_PLACED * len(scans):
            looser = replace(standards, limit=MORE * standards.limit)
            busier = self._decision(self._groups(scans, looser), looser, holds=False)
            decision = max(decision, busier, key=lambda one: one.placed)
        return decision

    def _decision(self, groups: list[Group], standards: Standards, holds: bool) -> Decision:
        """What is left of groups when they are looked over."""
        doubts = Doubts(self._joiner, standards, holds, self._telling)
        reliability = self.reliability(groups, standards)
        if standards.believes_one and not holds:
            return self._with_places(_apart(groups), doubts, reliability)
        sure = doubts.sure_parts(groups)
        for _ in range(MAX_ROUNDS if standards.believes_one else 0):
            grown = self._joiner.grow(self._counted(sure), standards)
            if [group.scans for group in grown] == [group.scans for group in sure]:
                break
            sure = doubts.sure_parts(grown)
        return self._with_places(sure, doubts, reliability)

    def _decided(self, scans: list[int]) -> tuple[list[Group], Standards, bool]:
        """The groups, by which standards, and whether what pairs say by themselves holds."""
        if not self._sees_all_round(scans):
            groups = self._of_narrow_views(scans)
            return groups, LENIENT, self.reliability(groups, LENIENT) >= LEAST_RELIABLE
        trusting = [LENIENT, BUSY] if self._loops(scans) >= len(scans) / 2 else []
        strict = self._strict()
        wary = replace(strict, most_overlap=MOST_OVERLAP)
        for standards in [*trusting, strict, wary]:
            if standards is not wary and not self._holds(self._first(scans, standards), standards):
                continue
            groups = self._groups(scans, standards)
            if holds := self._holds(groups, standards):
                break
        return groups, standards, holds

    def _sees_all_round(self, scans: list[int]) -> bool:
        """Whether free space tells where scans cannot be."""
        sees = [self._joiner.witness.sees_all_round(scan) for scan in scans]
        return bool(np.mean(sees) >= MOSTLY_ALL_ROUND)

    def _of_narrow_views(self, scans: list[int]) -> list[Group]:
        """The groups that sure pairs make, and what the others add."""
        self._joiner.witness.hopeless = HOPELESS * LENIENT.limit
        sure = self._grown(scans, replace(LENIENT, least_trust=SURE_PAIR))
        return self._joiner.grow(sure, LENIENT)

    def _groups(self, scans: list[int], standards: Standards) -> list[Group]:
        """The groups that come of the scans."""
        self._joiner.witness.hopeless = HOPELESS * standards.limit
        if standards.believes_one:
            return repaired(self._grown(scans, standards), self._joiner, standards)
        return self._searched(scans, standards)

    def _first(self, scans: list[int], standards: Standards) -> list[Group]:
        """Groups at a glance; where pairs would be believed, from what they are sure of alone."""
        self._joiner.witness.hopeless = HOPELESS * standards.limit
        proposals = self._joiner.proposals
        if standards.believes_one:
            proposals = {k: pair.answer for k, pair in proposals.items() if pair.confidence > 0}
        return first_configuration(scans, proposals, self._joiner.witness, standards).groups

    def _holds(self, groups: list[Group], standards: Standards) -> bool:
        """Whether what pairs say by themselves holds in these groups."""
        is_reliable = self.reliability(groups, standards) >= RELIABLE
        return is_reliable and not self._lies_on_another(groups)

    def _loops(self, scans: list[int]) -> int:
        """How many independent loops the registered pairs make: without, nothing confirms them."""
        keys = [key for key, pair in self._joiner.proposals.items() if pair.confidence > 0]
        return len(keys) - len(scans) + len(components(scans, keys))

    def _strict(self) -> Standards:
        """Strict standards, as far as this set's own registered pairs keep them."""
        sure = [p for p in self._joiner.proposals.values() if p.confidence > 0]
        own = [p.violation[0] for p in sure if p.overlap[0] <= MOST_OVERLAP]
        noise = NOISE * float(np.quantile(own, BEST_SHARE)) if own else 0.0
        return replace(STRICT, limit=min(max(STRICT.limit, noise), LENIENT.limit))

    def reliability(self, groups: list[Group], standards: Standards) -> float:
        """Share of the registered pairs that hold, of those that can be told; 1 for none."""
        group_of = {scan: group for group in groups for scan in group.poses}
        words = [
            self._joiner.holds(key, group_of, standards)
            for key, pair in self._joiner.proposals.items()
            if pair.confidence > 0
        ]
        told = [word for word in words if word is not None]
        return sum(told) / len(told) if told else 1.0

    def _lies_on_another(self, groups: list[Group]) -> bool:
        """Whether scans of alike rooms were laid on each other."""
        for group in groups:
            for a, b in combinations(group.scans, 2):
                T = invert(group.poses[a]) @ group.poses[b]
                overlap, violation = self._joiner.witness.pair(a, b, T[None])[:, 0]
                if overlap > MOST_OVERLAP and violation > SAME_PLACE_LIMIT:
                    return True
        return False

    def _grown(self, scans: Iterable[int], standards: Standards) -> list[Group]:
        return self._joiner.grow((Group.single(scan) for scan in scans), standards)

    def _searched(self, scans: list[int], standards: Standards) -> list[Group]:
        """The groups of which most agrees, in parts about which nothing else is as good."""
        joiner = self._joiner
        asked = scans, joiner.proposals, joiner.witness, standards
        found = configurations(*asked, self._known.get(standards))
        self._known[standards] = found
        best = found[0]
        parts = numbered(common_parts(best, found[1:], joiner))
        groups = tightened(best.groups, joiner, self._settle, standards)
        groups = joiner.grow(groups, standards)
        return [part for group in groups for part in in_parts(group, best, parts, joiner)]

    def _counted(self, groups: list[Group]) -> list[Group]:
        """The groups with their support, which cutting forgets."""
        return [Group(group.poses, sum(self._joiner.overlaps(group).values())) for group in groups]

    def _with_places(self, groups: list[Group], doubts: Doubts, reliability: float) -> Decision:
        """What is known of the scans that stand alone."""
        standards = doubts.standards
        fits: dict[int, list[FloatArray]] = {}
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
                fits[scan] = [way.T for way in best[2]]
                host[scan] = best[1].scans[0]
        return Decision(groups, fits, host, reliability, doubts.unsure)


def _apart(groups: list[Group]) -> list[Group]:
    """Every scan alone."""
    return [Group.single(scan) for scan in sorted(s for group in groups for s in group.poses)]
