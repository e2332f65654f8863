"""Where else scans might stand: in free places, or in each other's."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.groups import SAME_VOXELS, Group, Joiner
from skipnet.projects.ways import Standards, Way
from skipnet.projects.witness import leaders
from skipnet.types import FloatArray


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
        float(said.closest[0]),
    )
    return here, [way for way, same in zip(ways, is_here, strict=True) if not same]


def exchanged(group: Group, joiner: Joiner, standards: Standards) -> set[int]:
    """Scans that might as well stand in each other's places, in rings of two, three or more.

    Of alike rooms along a corridor each fits in many places, of which the others hold all but its
    own. That nothing contradicts a group then says that all are in one of several orders.

    Args:
        group: scans where they stand.
        joiner: knows what pairs proposed.
        standards: what another place must fulfil.
    """
    takes = {scan: places_taken(group, scan, joiner, standards) for scan in group.scans}
    reached: dict[int, set[int]] = {}
    for scan in group.scans:
        seen, left = set(), list(takes[scan])
        while left:
            other = left.pop()
            if other not in seen:
                seen.add(other)
                left += takes[other]
        reached[scan] = seen
    return {scan for scan in group.scans if scan in reached[scan]}


def places_taken(
    group: Group, scan: int, joiner: Joiner, standards: Standards
) -> dict[int, FloatArray]:
    """Scans whose places would fit one scan about as well as its own, were they not there.

    Returns:
        Of each the (4, 4) pose that the scan would have there, in the group's frame.
    """
    here, others = places(group, scan, joiner)
    rest = group.without(scan)
    taken: dict[int, FloatArray] = {}
    for way in others:
        holder = _most_contradicting(rest, scan, way.T, joiner)
        without = rest.without(holder)
        said = joiner.witness.all_pairs(without.poses, {scan: np.eye(4)}, way.T[None])
        enough = said.support[0] >= standards.rival_support * here.support
        if way.contradiction > standards.limit >= said.contradiction[0] and enough:
            taken.setdefault(holder, way.T)
    return taken


def _most_contradicting(rest: Group, scan: int, T: FloatArray, joiner: Joiner) -> int:
    """The scan of a group that contradicts most that another one stands at T."""
    excess = {
        other: float(joiner.witness.pair(other, scan, (invert(pose) @ T)[None])[1, 0])
        for other, pose in rest.poses.items()
    }
    return max(sorted(excess), key=excess.__getitem__)
