"""What all configurations have in common that explain the scans about as well as the best one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.assembly import numbered
from skipnet.projects.configurations import Configuration
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.sameness import same_place

WORTH_A_DOUBT = 0.3
"""Another configuration counts in which less is lost than this share of what agrees between scans
that lie to each other otherwise in it, or ..."""
LITTLE_LOST = 0.15
"""... than this in all: a scan of which few say little may say as little elsewhere."""


def common_parts(
    best: Configuration, others: Sequence[Configuration], joiner: Joiner
) -> list[list[int]]:
    """Scans of the best configuration in parts that lie alike in all others that count.

    Another one counts if it explains about as much as the best one, and as any that counts already:
    else what is wrong in it would hide behind what may as well be so.

    Args:
        best: of which most agrees.
        others: the better ones first.
        joiner: knows the scans.
    """
    counting = [best]
    parts = [group.scans for group in best.groups]
    for other in others:
        if all(len(part) == 1 for part in parts):  # as in a bare corridor: all is in doubt
            break
        rows = (row for row, one in enumerate(counting) if not _counts(other, one, joiner))
        against = next(rows, None)
        if against is not None:  # asked first next time: what is less than it mostly is so again
            counting.insert(0, counting.pop(against))
        else:
            counting.append(other)
            number = numbered(_alike(best, other, joiner))
            parts = [
                [scan for scan in part if number[scan] == n]
                for part in parts
                for n in sorted({number[scan] for scan in part})
            ]
    return parts


def in_parts(
    group: Group, best: Configuration, part_of: Mapping[int, int], joiner: Joiner
) -> list[Group]:
    """A group in the parts that are common to all configurations that count.

    Args:
        group: of one or several groups of the best configuration, which joined afterwards.
        best: the configuration.
        part_of: number of the part of each scan. Of each group that joined late the largest part
            goes where it shares most, and what may lie to that part otherwise stands apart.
        joiner: knows the scans.
    """
    came = [_parted(set(one) & set(group.poses), part_of) for one in best.poses]
    came = sorted(filter(None, came), key=lambda parts: -sum(map(len, parts)))
    overlaps, seeds = joiner.overlaps(group), [set(part) for part in came[0]]
    for late, *apart in came[1:]:
        shared = [
            sum(share for key, share in overlaps.items() if late & {*key} and part & {*key})
            for part in seeds
        ]
        seeds[int(np.argmax(shared))] |= late
        seeds += apart
    return [Group({s: group.poses[s] for s in sorted(part)}) for part in seeds]


def _parted(scans: set[int], part_of: Mapping[int, int]) -> list[set[int]]:
    """Scans by their parts, the largest first."""
    parts: dict[int, set[int]] = {}
    for scan in sorted(scans):
        parts.setdefault(part_of[scan], set()).add(scan)
    return sorted(parts.values(), key=lambda part: (-len(part), min(part)))


def _counts(other: Configuration, better: Configuration, joiner: Joiner) -> bool:
    """Whether a configuration explains the scans about as well as a better one."""
    number = numbered(_alike(better, other, joiner))
    at_stake = sum(share for (a, b), share in better.shares.items() if number[a] != number[b])
    return better.merit - other.merit <= max(WORTH_A_DOUBT * at_stake, LITTLE_LOST)


def _alike(one: Configuration, other: Configuration, joiner: Joiner) -> list[list[int]]:
    """All scans, in parts that lie to each other in one configuration as in the other.

    A part that merely was not joined in the other, and joined nothing else, is where it was.
    """
    result, group_of = [], {scan: group for group in other.groups for scan in group.poses}
    for group in one.groups:
        seconds = {group_of[scan].scans[0]: group_of[scan] for scan in group.scans}
        parts = [
            (second, part) for second in seconds.values() for part in _common(group, second, joiner)
        ]
        main, most = max(parts, key=lambda part: (len(part[1]), [-scan for scan in part[1]]))
        stays = [
            scan
            for second, part in parts
            for scan in part
            if part is most or (second is not main and second.scans == part)
        ]
        moved = [part for _, part in parts if not set(part) <= set(stays)]
        result += [stays, *moved]
    return result


def _common(group: Group, other: Group, joiner: Joiner) -> list[list[int]]:
    """Scans of both groups, in parts that lie in both alike."""
    parts, left = [], [scan for scan in group.scans if scan in other.poses]
    T_group, T_other = (np.array([g.poses[scan] for scan in left]) for g in (group, other))
    while len(left) > 1:
        motion = T_other[0] @ invert(T_group[0])
        same = same_place(joiner.witness, left, motion @ T_group, T_other)
        parts.append([scan for scan, is_same in zip(left, same, strict=True) if is_same])
        left = [scan for scan in left if scan not in parts[-1]]
        T_group, T_other = T_group[~same], T_other[~same]
    return [*parts, left] if left else parts  # a single one lies like itself
