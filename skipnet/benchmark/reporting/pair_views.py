"""A pair of a benchmark in 3-D, as a method has it."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import transform_points
from skipnet.types import FloatArray, Pair
from skipnet.viz.colours import SOURCE_COLOUR, TARGET_COLOUR
from skipnet.viz.residuals import distances_m
from skipnet.viz.viewed import ViewedPose, ViewedScan
from skipnet.viz.viewer import viewer
from skipnet.viz.views import robust_bounds_m, thin

_BRIGHTEST_SHARE = 0.005
"""Of the target's extent: the residual shown in yellow."""
VIEWED_POINTS = 40_000
"""Of a pair in 3-D; a report has several."""


def pair_view(pair: Pair, T_target_source: FloatArray) -> str:
    """A pair in 3-D: as the method has it, with its residuals, in truth, and before."""
    stays = np.eye(4)
    shown_m = [thin(scan_m, VIEWED_POINTS // 2) for scan_m in (pair.source_m, pair.target_m)]
    moved_m = transform_points(T_target_source, shown_m[0])
    away_m = (
        distances_m(moved_m, pair.target_m),
        distances_m(shown_m[1], transform_points(T_target_source, pair.source_m)),
    )
    scans = [
        ViewedScan(name, scan_m, tint, residuals_m=residuals_m)
        for name, scan_m, tint, residuals_m in zip(
            ("source", "target"), shown_m, (SOURCE_COLOUR, TARGET_COLOUR), away_m, strict=True
        )
    ]
    low_m, high_m = robust_bounds_m(shown_m[1])
    brightest_m = _BRIGHTEST_SHARE * float((high_m - low_m).max())
    poses = [
        ViewedPose("answer", "What the method answered.", (T_target_source, stays)),
        ViewedPose("truth", "Where the source is in truth.", (pair.T_target_source, stays)),
        ViewedPose("as they came", "Both scans as they came.", (stays, stays)),
    ]
    return viewer(scans, poses, brightest_m=brightest_m, most=VIEWED_POINTS)
