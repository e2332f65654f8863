"""How well scans fit where they are not: what chance makes of rooms that look alike."""

from __future__ import annotations

from collections.abc import Container, Sequence

from skipnet.geometry import invert
from skipnet.projects.configurations import edges_of
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.sameness import same_place
from skipnet.projects.ways import Standards
from skipnet.projects.witness import LITTLE_OVERLAP, STRAY_SHARE, Witness
from skipnet.types import FloatArray


def best_misfit(
    joiner: Joiner, groups: Sequence[Group], firm: Container[int], standards: Standards
) -> float:
    """What agrees in the best wrong place of scans whose right place is known.

    A place counts though one scan of its group speaks against it: a scan of an alike room is taken
    for a missing one where the one that would object is missing, too.

    Args:
        joiner: knows what pairs proposed.
        groups: of scans that lie right to each other.
        firm: the scans whose place is known.
        standards: what a place must fulfil.

    Returns:
        The sum over the pairs of the share of the surfaces that agree; 0 if no wrong place is fit.
    """
    group_of = {scan: group for group in groups for scan in group.poses}
    edges, best = edges_of(joiner.proposals, joiner.witness, standards), 0.0
    for (target, source), T in zip(edges.ends.tolist(), edges.T_target_source, strict=True):
        for scan, other, T_other_scan in ((source, target, T), (target, source, invert(T))):
            if scan in firm and other in group_of:
                group = group_of[other]
                place = group.poses[other] @ T_other_scan
                if not _stands(joiner.witness, group, scan, place):
                    rest = group.without(scan)
                    best = max(best, _agrees(joiner.witness, rest, scan, place, standards))
    return best


def _stands(witness: Witness, group: Group, scan: int, place: FloatArray) -> bool:
    """Whether a scan is in a place of a group."""
    here = group.poses.get(scan)
    return here is not None and bool(same_place(witness, scan, here, place))


def _agrees(
    witness: Witness, group: Group, scan: int, place: FloatArray, standards: Standards
) -> float:
    """What agrees with a scan in a place of a group; 0 if more than one other scan objects."""
    support = excess = objections = 0.0
    for a, b, T_a_b in witness.meeting(group.poses, {scan: place}):
        overlap, violation = witness.about(a, b, T_a_b)
        beyond = max(violation - STRAY_SHARE, 0.0)
        is_twin = overlap > standards.most_overlap
        is_twin = is_twin and not witness.same_station(a, b, T_a_b[None])[0]
        if is_twin or beyond > standards.limit:
            objections += 1
            if objections > 1:
                return 0.0
        else:
            support, excess = support + overlap, excess + beyond
    return support if excess <= standards.limit * (support + LITTLE_OVERLAP) else 0.0
