"""Points that were thinned to a lattice: their errors are no noise, and do not average out.

Programs thin scans by rounding coordinates. A surface then shows as steps, whose pattern is the
same over large parts of it.
"""

from __future__ import annotations

import numpy as np

from skipnet.geometry import transform_points
from skipnet.skipmap.tree import SkipTree
from skipnet.types import FloatArray

SAMPLES = 1000
"""Points that are looked at ..."""
FEW = 50
"""... and fewer say nothing."""
SAME_VOXELS = 1e-3
"""Coordinates nearer than this are equal."""
ROUND_SHARE = 0.05
"""Of a step: how near to whole steps coordinates lie ..."""
MIN_ROUND = 0.95
"""... and how many of them; of arbitrary ones a tenth do."""


def lattice_step_m(fine_tree: SkipTree, T_given_own: FloatArray) -> float:
    """Edge of the lattice on which a scan's points lie; 0 where they do not.

    Asked is the frame that the scan was given in: a lattice that was turned is not found.

    Args:
        fine_tree: of the scan. The centroid of a voxel with one point is that point.
        T_given_own: (4, 4) to the frame that it was given in.
    """
    single = np.flatnonzero(fine_tree.moments.count == 1)
    if len(single) < FEW:
        return 0.0
    rows = single[np.linspace(0, len(single) - 1, min(SAMPLES, len(single))).astype(np.int64)]
    points_m = transform_points(T_given_own, fine_tree.centroids_m[rows])
    same_m = SAME_VOXELS * fine_tree.voxel_size_m
    steps_m = [_step_m(values_m, same_m) for values_m in points_m.T]
    return max(steps_m) if min(steps_m) > 0 else 0.0


def _step_m(values_m: FloatArray, same_m: float) -> float:
    """The step of which (N,) coordinates' differences are multiples; 0 without one."""
    apart_m = np.diff(np.sort(values_m))
    apart_m = apart_m[apart_m > same_m]
    if len(apart_m) == 0:
        return 0.0
    step_m = float(apart_m.min())
    off = np.abs(apart_m / step_m - np.round(apart_m / step_m))
    return step_m if (off < ROUND_SHARE).mean() >= MIN_ROUND else 0.0
