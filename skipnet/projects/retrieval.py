"""Which pairs are worth a search, and a costly one: a few between groups that nothing joins yet."""

from __future__ import annotations

from collections.abc import Mapping
from heapq import nsmallest
from itertools import combinations

import numpy as np

from skipnet.projects.arbiter import STRICT
from skipnet.projects.decision import Decision
from skipnet.projects.groups import Group, Joiner, in_order
from skipnet.projects.priors import Priors
from skipnet.projects.ways import PairKey, rivals

ALL_PAIRS = 30
"""Of so many scans all pairs are searched; of more all are glanced at, and of each scan ..."""
PARTNERS = 15
"""... so many pairs searched, the most promising ones, ..."""
NEIGHBOURS = (1, 2)
"""... and those with the scans that came so many before and after it."""
PAIRS_PER_JOIN = 2
"""Pairs that are searched between two groups."""
SEARCHES_PER_SCAN = 4
"""So many costly searches are made in all, for each scan."""


def partners(promises: Mapping[PairKey, float], scans: int) -> set[PairKey]:
    """The pairs that are searched of so many scans that not all can be.

    Of every scan those with the most promising others, and with its neighbours in the order in
    which they came, which often is that of shooting.
    """
    chosen = {(scan, scan + step) for step in NEIGHBOURS for scan in range(scans - step)}
    of_scan: list[list[tuple[float, PairKey]]] = [[] for _ in range(scans)]
    for key, promise in promises.items():
        for scan in key:
            of_scan[scan].append((-promise, key))
    return chosen | {key for pairs in of_scan for _, key in nsmallest(PARTNERS, pairs)}


def worth_searching(decision: Decision, joiner: Joiner, priors: Priors) -> list[PairKey]:
    """Pairs between groups that no way fits, those first whose proposals were the best.

    Args:
        decision: groups so far.
        joiner: knows what pairs proposed.
        priors: what is believed; pairs that it gives no hope are left out.
    """
    reach_m = 2 * max(joiner.witness.reach_m)
    chosen: list[tuple[float, PairKey]] = []
    for first, second in combinations(decision.groups, 2):
        if rivals(joiner.ways(*in_order(first, second)), STRICT):
            continue
        across = [
            key
            for key in _across(first, second)
            if key in joiner.proposals and not priors.is_hopeless(key, reach_m)
        ]
        ranked = sorted((-_promise(joiner, key), key) for key in across)
        chosen += ranked[:PAIRS_PER_JOIN]
    count = SEARCHES_PER_SCAN * sum(len(group.poses) for group in decision.groups)
    return sorted(key for _, key in sorted(chosen)[:count])


def _across(first: Group, second: Group) -> list[PairKey]:
    return [(min(a, b), max(a, b)) for a in first.scans for b in second.scans]


def _promise(joiner: Joiner, key: PairKey) -> float:
    """How much agrees in the best proposal of a pair, devalued by what contradicts."""
    found = joiner.proposals[key]
    return float(np.max(found.overlap * np.exp(-100 * found.violation), initial=0.0))
