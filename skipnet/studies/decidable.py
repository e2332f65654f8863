"""Which scans of a simulated floor can be decided at all, by the truth alone.

With all other scans where they are in truth, a scan can be decided if it shares enough with others
that can, and if no other place that any search proposes explains it about as well, be it that of a
scan that takes its own place in turn: a room furnished like another one cannot be told from it, and
a scan that shares next to nothing rests on nothing.
Only what was searched, and the judge, know of other places: who finds them not, cannot list them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.arbiter import STRICT
from skipnet.projects.components import components
from skipnet.projects.exchanges import places_taken
from skipnet.projects.groups import SAME_VOXELS, Group, Joiner, in_order
from skipnet.projects.witness import LITTLE_OVERLAP, MIN_OVERLAP, leaders
from skipnet.types import FloatArray

LEAST_SHARE = 0.15
"""Of both scans' surfaces, summed over all others that can be decided."""
LONGEST_RING = 4
AS_WELL = 0.5
"""Another place that explains this much of what the true one does is as good."""


EXCHANGE = replace(STRICT, rival_support=AS_WELL)


def decidable(
    joiner: Joiner, T_world_scan: Sequence[FloatArray], building: Sequence[int]
) -> set[int]:
    """Scans that can be decided.

    Args:
        joiner: knows what pairs proposed.
        T_world_scan: (4, 4) true pose of each scan's own frame in its building's.
        building: of each scan.
    """
    shares = _shares(joiner, T_world_scan, building)
    linked = [key for key, share in shares.items() if share >= MIN_OVERLAP]
    parts = components(range(len(building)), linked)
    groups = [Group({scan: T_world_scan[scan] for scan in part}) for part in parts]
    left = {scan for group in groups for scan in group.scans if not _is_torn(joiner, groups, scan)}
    left -= {scan for group in groups for scan in _interchangeable(joiner, group)}
    while True:
        within = {scan: 0.0 for scan in left}
        for (a, b), share in shares.items():
            if share >= MIN_OVERLAP and a in left and b in left:
                within[a] += share
                within[b] += share
        loose = {scan for scan, share in within.items() if share < LEAST_SHARE}
        if not loose:
            return left
        left -= loose


def _shares(
    joiner: Joiner, T_world_scan: Sequence[FloatArray], building: Sequence[int]
) -> dict[tuple[int, int], float]:
    """Of each pair of one building, what both see in truth."""
    shares = {}
    for a, b in combinations(range(len(building)), 2):
        if building[a] == building[b]:
            T = invert(T_world_scan[a]) @ T_world_scan[b]
            shares[a, b] = float(joiner.witness.pair(a, b, T[None])[0, 0])
    return shares


def _is_torn(joiner: Joiner, groups: Sequence[Group], scan: int) -> bool:
    """Whether a scan fits elsewhere about as well as where it is, all others being right."""
    own = next(group for group in groups if scan in group.poses)
    rest, alone, T = own.without(scan), Group.single(scan), own.poses[scan]
    support = joiner.witness.all_pairs(rest.poses, alone.poses, T[None]).support[0]
    for group in (rest, *(group for group in groups if group is not own)):
        first, second = in_order(group, alone) if group.poses else (alone, alone)
        for way in joiner.ways(first, second) if group.poses else []:
            there = way.T if second is alone else invert(way.T)
            is_true = group is rest and _is_same(joiner, scan, T, there)
            fits = way.contradiction <= STRICT.limit and way.support >= AS_WELL * support
            if fits and not is_true:
                return True
    return False


def _interchangeable(joiner: Joiner, group: Group) -> set[int]:
    """Scans of a group that can change places in a ring, and all is explained about as well."""
    takes = {scan: places_taken(group, scan, joiner, EXCHANGE) for scan in group.scans}
    found: set[int] = set()
    for length in range(2, LONGEST_RING + 1):
        for ring in permutations(group.scans, length):
            after = [*ring[1:], ring[0]]
            links = zip(ring, after, strict=True)
            if ring[0] == min(ring) and all(holder in takes[scan] for scan, holder in links):
                there = {s: takes[s][holder] for s, holder in zip(ring, after, strict=True)}
                found |= set(ring) if _explains(joiner, group, there) else set()
    return found


def _explains(joiner: Joiner, group: Group, there: dict[int, FloatArray]) -> bool:
    """Whether scans of a group in other places explain about as much, and contradict nothing."""
    now = _said(joiner, group, set(there))
    then = _said(joiner, Group({**group.poses, **there}), set(there))
    return then[1] <= STRICT.limit and then[0] >= AS_WELL * now[0]


def _said(joiner: Joiner, group: Group, scans: set[int]) -> tuple[float, float]:
    """What agrees and what contradicts in the pairs of a group that have one of some scans."""
    witness, parts = joiner.witness, [(s, {s: group.poses[s]}) for s in sorted(scans)]
    agrees, excess, worst = 0.0, 0.0, 0.0
    for number, (_, alone) in enumerate(parts):
        before = {scan for scan, _ in parts[: number + 1]}
        rest = {s: T for s, T in group.poses.items() if s not in before}
        said = witness.all_pairs(rest, alone, np.eye(4)[None])
        agrees += float(said.support[0])
        excess += float(said.excess[0])
        worst = max(worst, float(said.worst[0]))
    return agrees, max(worst, excess / (agrees + LITTLE_OVERLAP))


def _is_same(joiner: Joiner, scan: int, T: FloatArray, other: FloatArray) -> bool:
    witness = joiner.witness
    size_m = SAME_VOXELS * witness.voxel_size_m
    return bool(leaders(np.stack([T, other]), witness.centres_m[scan], size_m)[1] == 0)
