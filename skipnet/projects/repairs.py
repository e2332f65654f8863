"""Groups that grew join by join are mended: scans that may stand wrong are put in last."""

from __future__ import annotations

from skipnet.projects.groups import Group, Joiner, merit
from skipnet.projects.places import places
from skipnet.projects.ways import Standards

CLEARLY_BETTER = 1.1
"""A place that is worth this many times more than the present one is better."""
MAX_ROUNDS = 5


def repaired(groups: list[Group], joiner: Joiner, standards: Standards) -> list[Group]:
    """Take out scans that may stand wrong, let the others grow, put them back last.

    Args:
        groups: as they grew; of every scan, those that stand alone included.
        joiner: knows what pairs proposed.
        standards: by which they grew.
    """
    suspects: set[int] = set()
    for _ in range(MAX_ROUNDS):
        fresh = {s for one in groups for s in _suspects(one, joiner, standards)} - suspects
        if not fresh:
            break
        suspects |= fresh
        for late in [fresh, suspects, *({scan} for scan in sorted(fresh))]:
            trial = _regrown(groups, late, joiner, standards)
            if merit(trial) > merit(groups) + 1e-6:
                groups = trial
    return groups


def _regrown(
    groups: list[Group], late: set[int], joiner: Joiner, standards: Standards
) -> list[Group]:
    """The groups anew, some scans put in last; groups that have none of them stay."""
    early = [group for group in groups if not late & set(group.poses)]
    torn = {scan for group in groups if late & set(group.poses) for scan in group.poses}
    early += [Group.single(scan) for scan in torn - late]
    grown = joiner.grow(early, standards)
    return joiner.grow([*grown, *(Group.single(scan) for scan in late)], standards)


def _suspects(group: Group, joiner: Joiner, standards: Standards) -> list[int]:
    """Scans that fewer than two pairs put where they are, or that fit better elsewhere."""
    if len(group.poses) < 2:
        return []
    return [
        scan
        for scan in group.scans
        if len(joiner.voters(group, scan)) < 2 or _has_better(group, scan, joiner, standards)
    ]


def _has_better(group: Group, scan: int, joiner: Joiner, standards: Standards) -> bool:
    here, others = places(group, scan, joiner)
    return any(way.worth(standards) > CLEARLY_BETTER * here.worth(standards) for way in others)
