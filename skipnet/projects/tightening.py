"""Joins that contradict a little too much as pairs put them, and not when all is aligned jointly.

A pair's pose slides along a corridor by centimetres where little holds it, and all who see the same
contradict it. What the join brings in may be just what holds it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from skipnet.projects.groups import Group, Joiner, in_order, join
from skipnet.projects.ways import Standards, Way

NEAR = 3.0
"""A join that contradicts by so many limits at most is asked about once more when all its scans
have been aligned jointly."""

Settle = Callable[[Group], Group]
"""Aligns the scans of a group jointly."""


def tightened(
    groups: Sequence[Group], joiner: Joiner, settle: Settle, standards: Standards
) -> list[Group]:
    """The groups, those joined that contradict too much only until all are aligned.

    Args:
        groups: as far as they have grown.
        joiner: knows what pairs proposed.
        settle: aligns a group.
        standards: what the aligned scans must fulfil.
    """
    groups, refused = list(groups), set[tuple[int, ...]]()
    while (found := _joined(groups, joiner, settle, standards, refused)) is not None:
        rest = [group for group in groups if not set(group.poses) & set(found.poses)]
        groups = joiner.grow([*rest, found], standards)
    return groups


def _joined(
    groups: Sequence[Group],
    joiner: Joiner,
    settle: Settle,
    standards: Standards,
    refused: set[tuple[int, ...]],
) -> Group | None:
    """Two groups as one, aligned and without too much contradiction, if there are."""
    for first, second, way in _near_misses(groups, joiner, standards):
        joined = join(first, second, way)
        scans = tuple(joined.scans)
        if scans in refused:
            continue
        tight = settle(joined)
        one, other = ({scan: tight.poses[scan] for scan in part.poses} for part in (first, second))
        said = joiner.witness.all_pairs(one, other, np.eye(4)[None])
        if said.contradiction[0] <= standards.limit:
            support = first.support + second.support + float(said.support[0])
            return replace(tight, support=support)
        refused.add(scans)
    return None


def _near_misses(
    groups: Sequence[Group], joiner: Joiner, standards: Standards
) -> list[tuple[Group, Group, Way]]:
    """Joins that only their contradiction forbids, and that not by much; the best first."""
    near = replace(standards, limit=NEAR * standards.limit)
    found = []
    for first, second in (in_order(*pair) for pair in combinations(groups, 2)):
        way = joiner.decided(first, second, near)
        if way is not None and way.contradiction > standards.limit:
            found.append((first, second, way))
    return sorted(found, key=lambda join: join[2].rank(near), reverse=True)
