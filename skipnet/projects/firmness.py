"""Whether enough speaks for a scan, or a block of scans, where much looks alike."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from skipnet.projects.components import bridges, components
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.ways import PairKey
from skipnet.projects.witness import MIN_OVERLAP

FIRM_WITNESSES = 3
"""Where much looks alike, a scan is believed that overlaps with so many others of its group, ..."""
FIRM_OVERLAP = 0.3
"""... or by so much in all, if the group has three scans or more, and with a single one only where
their pair registered: if the scan that belongs there is missing another may stand in its place."""
PECULIAR = 30
"""Two scans stand right to each other if so many fine voxels agree that those of another room would
not. Of sets drawn from 14 development floors 29 scans stood in the place of another whose own scan
was missing, with 10 at most that agreed with one that stood right; on two more floors two did, with
3. ``FIRM_WITNESSES`` and ``FIRM_OVERLAP`` alone believe ten of the 29. Of 296 that were measured
afterwards one stood wrong, with 61, in a long corridor: these believe it as well."""
Telling = Callable[[Group, PairKey], int]
"""How many fine voxels of two scans of a group agree that would not with those of another room."""


class Firmness:
    """Keeps of groups what enough speaks for."""

    def __init__(self, joiner: Joiner, holds: bool, telling: Telling) -> None:
        """Prepare to look.

        Args:
            joiner: knows what pairs proposed.
            holds: whether what pairs say by themselves holds.
            telling: asked of scans of which others say too little.
        """
        self._joiner = joiner
        self._holds = holds
        self._telling = telling

    def parts(self, group: Group) -> list[Group]:
        """A group in the parts that hang together for sure: those of which others say enough, and
        who agrees with one of them, or with each other, in what only they have."""
        firm = self._of_whom_enough_is_said(group)
        tied = [
            key
            for key, overlap in self._joiner.overlaps(group).items()
            if overlap >= MIN_OVERLAP and not set(key) <= firm and self._is_peculiar(group, key)
        ]
        parts = components(group.scans, [*pairwise(sorted(firm)), *tied])
        together = [Group({scan: group.poses[scan] for scan in part}) for part in parts]
        return [one for part in together for one in self._looked_over(part)]

    def _looked_over(self, group: Group) -> list[Group]:
        """A group, or what is firm of the blocks that one or two pairs alone hold together, which
        say too little."""
        blocks = self._blocks(group)
        if blocks is None:
            return [group]
        apart = [Group({scan: group.poses[scan] for scan in block}) for block in blocks]
        return [one for block in apart for one in self.parts(block)]

    def _blocks(self, group: Group) -> list[list[int]] | None:
        """Two blocks of several scans each between which too little is said, if there are."""
        overlaps = self._joiner.overlaps(group)
        shares = {key: share for key, share in overlaps.items() if share >= MIN_OVERLAP}
        weak = [key for key, share in shares.items() if share < FIRM_OVERLAP]
        for also in [None, *weak]:
            rest = [key for key in shares if key != also]
            for bridge in bridges(group.scans, rest):
                cut = {bridge} if also is None else {bridge, also}
                if sum(shares[key] for key in cut) >= FIRM_OVERLAP:
                    continue
                blocks = components(group.scans, [key for key in rest if key != bridge])
                if _are_two(blocks, cut) and not any(self._is_sure(group, key) for key in cut):
                    return blocks
        return None

    def _is_sure(self, group: Group, key: PairKey) -> bool:
        """Whether the word of a pair is enough."""
        if self._holds and confidence(self._joiner, group, key) > 0:
            return True
        return self._is_peculiar(group, key)

    def _is_peculiar(self, group: Group, key: PairKey) -> bool:
        return self._telling(group, key) >= PECULIAR

    def _of_whom_enough_is_said(self, group: Group) -> set[int]:
        """The scans of a group without those of which too few others of these say too little."""
        while len(group.poses) > 1:
            firm = {
                scan
                for scan, agree in self._agreeing(group).items()
                if self._is_firm(group, scan, agree)
            }
            if len(firm) == len(group.poses):
                return firm
            group = Group({scan: group.poses[scan] for scan in group.scans if scan in firm})
        return set()

    def _agreeing(self, group: Group) -> dict[int, list[float]]:
        """Of each scan the shares that agree with others of its group, where worth mentioning."""
        overlaps = {k: v for k, v in self._joiner.overlaps(group).items() if v >= MIN_OVERLAP}
        return {scan: [v for key, v in overlaps.items() if scan in key] for scan in group.scans}

    def _is_firm(self, group: Group, scan: int, agree: list[float]) -> bool:
        """Whether others of a group say enough of a scan, by what agrees with each of them."""
        if len(agree) >= FIRM_WITNESSES:
            return True
        is_registered = self._is_registered(group, scan)
        says_enough = len(group.poses) >= 3 and sum(agree) >= FIRM_OVERLAP
        return (says_enough and (len(agree) > 1 or is_registered)) or (
            self._holds and is_registered
        )

    def _is_registered(self, group: Group, scan: int) -> bool:
        """Whether a pair that registered by itself puts a scan where it is."""
        return any(
            confidence(self._joiner, group, key) > 0 for key in self._joiner.voters(group, scan)
        )


def confidence(joiner: Joiner, group: Group, key: PairKey) -> float:
    """Of a pair that registered by itself as it lies in its group; else 0."""
    pair = joiner.proposals.get(key)
    if pair is None or pair.confidence == 0 or not joiner.proposed(group, key)[0]:
        return 0.0
    return pair.confidence


def _are_two(blocks: list[list[int]], cut: set[PairKey]) -> bool:
    """Whether blocks are two, of several scans each, and all pairs of a cut lie between them."""
    if len(blocks) != 2 or min(len(block) for block in blocks) < 2:
        return False
    first = set(blocks[0])
    return all((a in first) != (b in first) for a, b in cut)
