"""Points far from all others: rows of zeros among map coordinates, dust, echoes of glass.

One of them at a great distance decides where a scan's axes and voxels lie, and some per cent of
them spread over a large space ask for voxels as large as rooms. They are left out of what is
registered, and counted.
"""

from __future__ import annotations

import numpy as np

from skipnet.clouds.statistics import farthest_m
from skipnet.types import BoolArray, FloatArray

NEIGHBOURS = 5
"""A point is a stray when fewer others than this lie near it ..."""
NEAR_SPREADS = 0.25
"""... within this share of the scan's spread (median distance from the middle: three quarters of
the points lie within one). Of real scans of ten kinds and simulated ones of six at most 0.12 % of
the points are so far from others; of those with 5 % of clutter in a space 1.5 times as wide as the
scan, or wider, all the clutter is."""
FAR_SPREADS = 100.0
"""... or when it lies farther than this from the middle, in whatever company."""
WORTH_LOOKING = 0.01
"""Share of lonely points in a sample from which every point is looked at: of the same scans at most
0.8 %, with that clutter 4 % and more."""
MOST_STRAYS = 0.25
"""A larger share is no clutter, but what the scan consists of."""
_SAMPLE = 1 << 12
_MOST_CELLS = 1 << 10
_STRIDES = np.array([1.0, 1 << 12, 1 << 24])
"""Of a cell's number; all numbers are exact."""


def find_strays(points_m: FloatArray) -> BoolArray | None:
    """Which points are strays, by their distances alone: the frame does not matter.

    Args:
        points_m: (N, 3) points of a scan.

    Returns:
        (N,) bool; None where there are none, which a sample tells of most scans.
    """
    middle_m, spread_m, sample_m = _middle_and_spread(points_m)
    if spread_m == 0:
        return None
    is_far = farthest_m(points_m, middle_m) > FAR_SPREADS * spread_m
    if not is_far and _lonely_share(sample_m, spread_m) < WORTH_LOOKING:
        return None
    strays = _without_neighbours(points_m, NEAR_SPREADS * spread_m)
    if is_far:
        strays |= np.linalg.norm(points_m - middle_m, axis=1) > FAR_SPREADS * spread_m
    return strays if 0 < strays.mean() < MOST_STRAYS else None


def _middle_and_spread(points_m: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """(3,) middle, spread about it, and the (S, 3) sample, as seen from the middle, they are from.

    An even sample: what comes in lines or in the order of time is met everywhere.
    """
    rows = np.linspace(0, len(points_m) - 1, min(len(points_m), _SAMPLE)).astype(np.int64)
    sample_m = points_m[rows].astype(np.float64)
    middle_m = np.median(sample_m, axis=0)
    sample_m -= middle_m
    return middle_m, float(np.quantile(np.linalg.norm(sample_m, axis=1), 0.75)), sample_m


def _lonely_share(sample_m: FloatArray, spread_m: float) -> float:
    """Share of a sample's points without another in their own and the 26 cells around.

    Cells have the size of nearness.
    """
    cells = np.floor(sample_m / (NEAR_SPREADS * spread_m)).clip(-_MOST_CELLS, _MOST_CELLS)
    keys, counts = np.unique(cells @ _STRIDES, return_counts=True)
    total = np.zeros(len(keys))
    for step in np.ndindex(3, 3, 3):
        beside = keys + (np.array(step) - 1.0) @ _STRIDES
        place = np.searchsorted(keys, beside).clip(max=len(keys) - 1)
        total += np.where(keys[place] == beside, counts[place], 0)
    return float((total == 1).sum() / len(sample_m))


def _without_neighbours(points_m: FloatArray, near_m: float) -> BoolArray:
    """(N,) whether fewer than ``NEIGHBOURS`` others lie within a distance."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points_m, balanced_tree=False, compact_nodes=False)
    # The point itself is the nearest; a bounded query looks no farther than it must.
    distances_m, _ = tree.query(points_m, [NEIGHBOURS + 1], distance_upper_bound=near_m, workers=-1)
    return np.isinf(distances_m[:, 0])
