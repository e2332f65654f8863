"""Which scans of a simulated floor can be decided at all, by the truth alone.

With all other scans where they are in truth, a scan can be decided if it shares enough with others
that can, if no other place that any search proposes explains it half as well, and if no other
configuration of all scans that is found explains half as well what the true one does: a room
furnished like another one cannot be told from it, and a scan that shares next to nothing rests on
nothing. Only what was searched, and the judge, know of other places: who finds them not, cannot
list them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from skipnet.geometry import invert
from skipnet.projects.alternatives import common_parts
from skipnet.projects.arbiter import STRICT
from skipnet.projects.assembly import numbered
from skipnet.projects.components import components
from skipnet.projects.configurations import Configuration
from skipnet.projects.groups import Group, Joiner, in_order
from skipnet.projects.orders import configurations
from skipnet.projects.sameness import same_place
from skipnet.projects.ways import MOST_OVERLAP, PairKey
from skipnet.projects.witness import MIN_OVERLAP
from skipnet.types import FloatArray

LEAST_SHARE = 0.15
"""Of both scans' surfaces, summed over all others that can be decided."""
WARY = replace(STRICT, most_overlap=MOST_OVERLAP)
AS_WELL = 0.5
"""Another place that explains this much of what the true one does is as good."""


def decidable(
    joiner: Joiner, T_world_scan: Sequence[FloatArray], building: Sequence[int]
) -> set[int]:
    """Scans that can be decided.

    Args:
        joiner: knows what pairs proposed.
        T_world_scan: (4, 4) true pose of each scan's own frame in its building's.
        building: of each scan.
    """
    overlaps, truth = _true_configuration(joiner, T_world_scan, building)
    groups = truth.groups
    found = configurations(range(len(building)), joiner.proposals, joiner.witness, WARY)
    part = numbered(common_parts(truth, found, joiner))
    left = {scan for group in groups for scan in group.scans if not _is_torn(joiner, groups, scan)}
    while True:
        within = {scan: 0.0 for scan in left}
        for (a, b), share in overlaps.items():
            if a in left and b in left and part[a] == part[b]:
                within[a] += share
                within[b] += share
        loose = {scan for scan, share in within.items() if share < LEAST_SHARE}
        if not loose:
            return left
        left -= loose


def _true_configuration(
    joiner: Joiner, T_world_scan: Sequence[FloatArray], building: Sequence[int]
) -> tuple[dict[PairKey, float], Configuration]:
    """What agrees, and all scans where they are, those together that hang together.

    As in the search, two scans that see the same say nothing: they may be of two rooms as well.
    """
    overlaps, against, shares = {}, {}, {}
    for a, b in combinations(range(len(building)), 2):
        if building[a] == building[b]:
            T = invert(T_world_scan[a]) @ T_world_scan[b]
            overlap, violation = joiner.witness.pair(a, b, T[None])[:, 0]
            if overlap <= MOST_OVERLAP or joiner.witness.same_station(a, b, T[None])[0]:
                shares[a, b] = float(overlap)
            if overlap >= MIN_OVERLAP:
                overlaps[a, b] = float(overlap)
                against[a, b] = float(violation) / STRICT.limit
    parts = components(range(len(building)), overlaps)
    poses = tuple({scan: T_world_scan[scan] for scan in part} for part in parts)
    shares = {key: share for key, share in shares.items() if key in overlaps}
    return overlaps, Configuration(poses, shares, against)


def _is_torn(joiner: Joiner, groups: Sequence[Group], scan: int) -> bool:
    """Whether a scan fits elsewhere about as well as where it is, all others being right."""
    own = next(group for group in groups if scan in group.poses)
    rest, alone, T = own.without(scan), Group.single(scan), own.poses[scan]
    support = joiner.witness.all_pairs(rest.poses, alone.poses, T[None]).support[0]
    for group in (rest, *(group for group in groups if group is not own)):
        first, second = in_order(group, alone) if group.poses else (alone, alone)
        for way in joiner.ways(first, second) if group.poses else []:
            there = way.T if second is alone else invert(way.T)
            is_true = group is rest and bool(same_place(joiner.witness, scan, T, there))
            fits = way.contradiction <= STRICT.limit and way.support >= AS_WELL * support
            if fits and not is_true:
                return True
    return False
