"""Whether part of a group could be moved: other ways to lay it that explain the scans as well.

Rooms alike and corridors that look the same from both ends fit in several places, not scan by scan
but in blocks: a corridor's one half may be turned against the other, and every scan of a half says
so with its neighbours. So proposals that the group does not follow are gathered by the motion that
they ask for, and the scans that would move are moved together.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.sameness import SAME_VOXELS, leaders
from skipnet.projects.ways import MIN_SUPPORT, RIVAL_CONTRADICTION, PairKey, Standards
from skipnet.projects.witness import STRAY_SHARE
from skipnet.types import FloatArray

MAX_MOTIONS = 40
"""Motions that are tried, those that most agrees with first."""

_Move = tuple[FloatArray, float, int, int]
"""(4, 4) motion in the group's frame, overlap of the pair that asks for it, scan that stays, scan
that moves."""


def rival_split(
    group: Group, joiner: Joiner, standards: Standards
) -> tuple[list[int], list[int]] | None:
    """Two parts of a group that can be laid against each other in another way; None if they can't.

    Args:
        group: two scans or more.
        joiner: knows what pairs proposed.
        standards: what counts as a rival.
    """
    moves = list(_moves(group, joiner, standards.limit))
    if not moves:
        return None
    moves.sort(key=lambda move: (-move[1], move[2], move[3]))
    centre_m = np.mean([_centre_m(group, joiner, scan) for scan in group.scans], axis=0)
    T = np.array([move[0] for move in moves])
    leader = leaders(T, centre_m, SAME_VOXELS * joiner.witness.voxel_size_m)
    overlap = np.array([move[1] for move in moves])
    rows = np.unique(leader)
    total = np.array([overlap[leader == row].sum() for row in rows])
    for row in rows[np.argsort(-total, kind="stable")[:MAX_MOTIONS]]:
        asking = [move for move, mine in zip(moves, leader == row, strict=True) if mine]
        split = _split(group, joiner, asking)
        if _is_rival(group, joiner, standards, split, T[row]):
            return split
    return None


def _moves(group: Group, joiner: Joiner, limit: float) -> Iterator[_Move]:
    """What proposals without contradiction ask for that the group does not follow."""
    for key in combinations(group.scans, 2):
        if key not in joiner.proposals:
            continue
        pair = joiner.proposals[key]
        followed = joiner.proposed(group, key)
        excess = np.maximum(pair.violation - STRAY_SHARE, 0.0)
        for row in np.flatnonzero(~followed & (pair.overlap >= MIN_SUPPORT) & (excess <= limit)):
            a, b = key
            motion = group.poses[a] @ pair.T_target_source[row] @ invert(group.poses[b])
            yield motion, float(pair.overlap[row]), a, b
            yield invert(motion), float(pair.overlap[row]), b, a


def _split(group: Group, joiner: Joiner, asking: list[_Move]) -> tuple[list[int], list[int]]:
    """Scans that stay and scans that move, as the pairs that ask for a motion have it.

    The others go with the side with which they share more.
    """
    side: dict[int, bool] = {}

    def pull(scan: int) -> float:
        """How much more a scan shares with those that move than with those that stay."""
        return sum(
            (1 if side[other] else -1) * _overlap(group, joiner, scan, other)
            for other in side
            if other != scan
        )

    left = [(stays, moves) for _, _, stays, moves in asking]
    both_ways = set(left) & {(moves, stays) for stays, moves in left}
    while left:
        # A pair that asks is on both sides: from those whose side is known to their partners.
        known = [pair for pair in left if side.get(pair[0]) is False or side.get(pair[1]) is True]
        asked = (known or left)[0]
        left.remove(asked)
        stays, moves = asked
        if not known and asked in both_ways and pull(moves) < pull(stays):
            stays, moves = moves, stays  # twice half a turn is none: either of them may move
        if not side.get(stays, False) and side.get(moves, True):
            side[stays], side[moves] = False, True
    open_scans = set(group.scans) - set(side)
    while open_scans:
        chosen = max(sorted(open_scans), key=lambda scan: abs(pull(scan)))
        side[chosen] = pull(chosen) > 0
        open_scans.remove(chosen)
    return [s for s in group.scans if not side[s]], [s for s in group.scans if side[s]]


def _is_rival(
    group: Group,
    joiner: Joiner,
    standards: Standards,
    split: tuple[list[int], list[int]],
    motion: FloatArray,
) -> bool:
    """Whether moving one part explains the scans about as well as leaving it."""
    stay, move = ({scan: group.poses[scan] for scan in part} for part in split)
    if not (stay and move):
        return False
    said = joiner.witness.all_pairs(stay, move, np.stack([np.eye(4), motion]))
    support, contradiction = said.support, said.contradiction
    return bool(
        contradiction[1] <= standards.limit
        and contradiction[1] <= contradiction[0] + RIVAL_CONTRADICTION * standards.limit
        and support[1] >= max(standards.rival_support * support[0], MIN_SUPPORT)
    )


def _overlap(group: Group, joiner: Joiner, first: int, second: int) -> float:
    key: PairKey = (min(first, second), max(first, second))
    T = invert(group.poses[key[0]]) @ group.poses[key[1]]
    return float(joiner.witness.pair(*key, T[None])[0, 0])


def _centre_m(group: Group, joiner: Joiner, scan: int) -> FloatArray:
    T = group.poses[scan]
    centre_m: FloatArray = T[:3, :3] @ joiner.witness.centres_m[scan] + T[:3, 3]
    return centre_m
