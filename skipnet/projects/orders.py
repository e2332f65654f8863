"""Growing in other orders: joins are made one by one, and an early wrong one keeps out right ones.

So growth is repeated with joins in other orders, and from groups of which some scans were taken
out. Of all that comes out, that is taken in which most agrees; and where others in which about as
much agrees have scans elsewhere, these are in doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.components import components
from skipnet.projects.groups import SAME_VOXELS, Group, Joiner, merit
from skipnet.projects.ways import Standards, Way
from skipnet.projects.witness import MIN_OVERLAP, leaders

FEW = 20
"""Of so many scans all is grown anew; growing more takes longer by the square of their number, so
it is done the less often, and fewer scans are taken out."""
FRESH = 12
"""Growths from single scans ..."""
RENEWED = 36
"""... and from the best groups so far, without some of their scans."""
SPREAD = 0.7
"""Standard deviation of the logarithm of the factor by which a join's worth is changed."""
TAKEN_OUT = (0.2, 0.6)
"""Least and largest share of the scans."""
ABOUT_AS_GOOD = 0.95
"""Another order counts that has this share of the best merit, and ..."""
WORTH_A_DOUBT = 0.25
"""... in which less is lost than this share of what agrees with scans that it puts elsewhere."""


@dataclass(frozen=True)
class Search:
    """What growing in several orders gave."""

    best: list[Group]
    others: list[list[Group]]


def in_many_orders(groups: Sequence[Group], joiner: Joiner, standards: Standards) -> Search:
    """Grow again and again, the same way for the same input.

    Args:
        groups: what growing gave in the first place; every scan is in one.
        joiner: knows what pairs proposed.
        standards: what a join must fulfil.
    """
    rng = np.random.default_rng(0)
    best, found = list(groups), [list(groups)]
    few = min(1.0, FEW / sum(len(group.poses) for group in groups))
    fresh = int(FRESH * few**2)
    shares = few * TAKEN_OUT[0], few * TAKEN_OUT[1]
    for attempt in range(fresh + int(RENEWED * few)):
        start = _taken_apart(best, joiner, rng, None if attempt < fresh else shares)
        grown = joiner.grow(start, standards, _favour(rng))
        found.append(grown)
        best = max(best, grown, key=_rounded)
    return Search(best, [one for one in found if one is not best])


def elsewhere(search: Search, joiner: Joiner) -> set[int]:
    """Scans of the best groups that another order puts elsewhere about as well."""
    doubtful: set[int] = set()
    for other in search.others:
        moved = [_moved(group, other, joiner) for group in search.best]
        at_stake = sum(map(partial(_support, joiner), search.best, moved))
        lost = merit(search.best) - merit(other)
        if lost <= min(WORTH_A_DOUBT * at_stake, (1 - ABOUT_AS_GOOD) * merit(search.best)):
            doubtful.update(*moved)
    return doubtful


def _support(joiner: Joiner, group: Group, scans: set[int]) -> float:
    """How much agrees with some scans of a group."""
    return sum(overlap for key, overlap in joiner.overlaps(group).items() if scans & set(key))


def _rounded(groups: Sequence[Group]) -> float:
    """Merit without the last digits, in which sums of another order differ."""
    return round(merit(groups), 6)


def _favour(rng: np.random.Generator) -> Callable[[Way], float]:
    """By how much each join counts more or less in one growth."""
    factors: dict[tuple[tuple[int, int], ...], float] = {}

    def factor(way: Way) -> float:
        """The same for the same voters."""
        voters = tuple(sorted(way.voters))
        if voters not in factors:
            factors[voters] = float(np.exp(SPREAD * rng.normal()))
        return factors[voters]

    return factor


def _taken_apart(
    groups: Sequence[Group],
    joiner: Joiner,
    rng: np.random.Generator,
    shares: tuple[float, float] | None,
) -> list[Group]:
    """All scans alone; or a share of them, the others in the parts that hang together."""
    scans = sorted(scan for group in groups for scan in group.poses)
    if shares is None:
        return [Group.single(scan) for scan in scans]
    share = rng.uniform(*shares)
    out = {scan for scan in scans if rng.random() < share}
    left = [Group.single(scan) for scan in sorted(out)]
    for group in groups:
        rest = {scan: T for scan, T in group.poses.items() if scan not in out}
        overlaps = joiner.overlaps(Group(rest))
        edges = [key for key, overlap in overlaps.items() if overlap >= MIN_OVERLAP]
        for part in components(sorted(rest), edges):
            inside = [overlap for key, overlap in overlaps.items() if set(key) <= set(part)]
            left.append(Group({scan: rest[scan] for scan in part}, sum(inside)))
    return left


def _moved(group: Group, others: Sequence[Group], joiner: Joiner) -> set[int]:
    """Scans of a group that other groups put elsewhere, as most of the group sees it."""
    witness, size_m = joiner.witness, SAME_VOXELS * joiner.witness.voxel_size_m
    parts: list[tuple[int, list[int]]] = []
    """Number of the other group, and the scans that lie in it as they do in this one."""
    for number, other in enumerate(others):
        left = [scan for scan in group.scans if scan in other.poses]
        while left:
            first = left[0]
            motion = other.poses[first] @ invert(group.poses[first])
            same = [
                scan
                for scan in left
                if leaders(
                    np.stack([motion @ group.poses[scan], other.poses[scan]]),
                    witness.centres_m[scan],
                    size_m,
                )[1]
                == 0
            ]
            parts.append((number, same))
            left = [scan for scan in left if scan not in same]
    if not parts:
        return set()
    main, most = max(parts, key=lambda part: (len(part[1]), -part[1][0]))
    moved: set[int] = set()
    for number, part in parts:
        # A part that merely was not joined, and joined nothing else, is where it was.
        is_apart = number != main and set(others[number].poses) == set(part)
        if part is not most and not is_apart:
            moved |= set(part)
    return moved
