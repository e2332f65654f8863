"""How far the points of scans that were brought together lie from each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.geometry import nearest
from skipnet.types import FloatArray, IntArray

_MOST_OF_ONE, _MOST_MEASURED = 200_000, 400_000
"""Points to which residuals are measured: of the other scan of a pair, of many scans together."""


def distances_m(from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """(N,) distance of each point to the nearest of others; these are thinned where very many."""
    if len(to_m) > _MOST_OF_ONE:
        rng = np.random.default_rng(0)
        to_m = to_m[np.sort(rng.choice(len(to_m), _MOST_OF_ONE, replace=False, shuffle=False))]
    return nearest(from_m, to_m)[0]


def residuals_m(
    placed_m: Sequence[FloatArray], rows: Sequence[IntArray], reach_m: float
) -> list[FloatArray]:
    """How far some points of every scan lie from the nearest point of any other, up to a reach.

    Args:
        placed_m: per scan its (N, 3) points, in one frame.
        rows: per scan of the points that are asked about.
        reach_m: larger distances come back as it.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    most = max(1, _MOST_MEASURED // len(placed_m))
    kept_m = [
        points_m if len(points_m) <= most else rng.choice(points_m, most, replace=False)
        for points_m in placed_m
    ]
    trees = [cKDTree(points_m, balanced_tree=False, compact_nodes=False) for points_m in kept_m]
    boxes = [(points_m.min(0) - reach_m, points_m.max(0) + reach_m) for points_m in kept_m]
    found = []
    for number, (points_m, asked) in enumerate(zip(placed_m, rows, strict=True)):
        asked_m = points_m[asked]
        nearest_m = np.full(len(asked_m), reach_m)
        for other, (low_m, high_m) in enumerate(boxes):
            near = np.flatnonzero(((asked_m > low_m) & (asked_m < high_m)).all(axis=1))
            if other == number or not len(near):
                continue
            away_m = trees[other].query(asked_m[near], distance_upper_bound=reach_m, workers=-1)[0]
            nearest_m[near] = np.minimum(nearest_m[near], away_m)
        found.append(nearest_m)
    return found
