"""The one length a user may set, found in the data: the voxel size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.clouds.statistics import principal_frame
from skipnet.compiled import compiled
from skipnet.geometry import invert, make_transform, transform_points
from skipnet.parallel.threads import side_by_side
from skipnet.skipmap.cells import halve_steps, occupied_cells, pack, unpack
from skipnet.skipmap.grouping import CELL_MAX, NO_ROWS, distinct_keys
from skipnet.types import FloatArray, IntArray

TARGET_VOXELS = 10_000
"""Occupied voxels that describe one scan well: 0.15 m voxels in a furnished 10 m room."""
MIN_POINTS_PER_VOXEL = 5
"""Mean points per voxel below which curvature and normals are guesses."""
MAX_VOXELS = 40_000
"""What a scan may be divided into for the sake of another that shows less of the same scene."""
MAX_ROUGHER = 2.0
"""A scan may ask for voxels so many times as large as the next one's wish."""

_SAMPLE = 1 << 15
"""Points that tell how far a larger scan spreads."""


def choose_voxel_size(
    *clouds_m: FloatArray, T_given_own: Sequence[FloatArray] | None = None
) -> float:
    """The voxel size for scans of one scene, from their own extent and density.

    Each scan asks for the size at which it occupies ``TARGET_VOXELS`` voxels, or fewer where it is
    too sparse for that; the largest of these sizes serves all. A scan of a room against the map of
    the building would be too rough that way: the largest size is at most ``MAX_ROUGHER`` times the
    next one, as far as the larger scan's points and ``MAX_VOXELS`` allow. Moving a scan rigidly
    does not matter.

    Args:
        clouds_m: (N, 3) points of each scan.
        T_given_own: (4, 4) ``principal_frame`` of each scan, where it is known already.

    Returns:
        Voxel size in the points' unit, to two digits: small changes of the input leave it alone.
    """
    frames = T_given_own or [principal_frame(points_m) for points_m in clouds_m]
    sizes_m = side_by_side(_sizes_for_one, clouds_m, [invert(frame) for frame in frames])
    wishes_m = sorted((wish_m for wish_m, _ in sizes_m), reverse=True)
    finest_m = max(finest_m for _, finest_m in sizes_m)
    size_m = min(wishes_m[0], MAX_ROUGHER * wishes_m[min(1, len(wishes_m) - 1)])
    return float(f"{max(size_m, finest_m):.2g}")


def _sizes_for_one(points_m: FloatArray, T_own_points: FloatArray) -> tuple[float, float]:
    """The size that a scan asks for and the finest that serves: occupied voxels are counted over
    doubling sizes and interpolated to both goals, logarithmically."""
    most = len(points_m) / MIN_POINTS_PER_VOXEL
    goals = min(TARGET_VOXELS, most), min(MAX_VOXELS, most)
    T_middle_points, spread_m = _middle_and_spread(points_m, T_own_points)
    reach_m = _reach_m(points_m, T_middle_points)
    spread_m = spread_m or reach_m
    finest_m = max(spread_m / 64, reach_m / CELL_MAX)
    keys = occupied_cells(points_m, finest_m, T_middle_points)
    steps: IntArray = keys - pack(unpack(keys).min(axis=0))
    counts = [len(steps)]
    while counts[-1] > max(goals[0], 1):
        steps = distinct_keys(halve_steps(steps), NO_ROWS)
        counts.append(len(steps))
    wish_m, least_m = (finest_m * _rougher(counts, goal) for goal in goals)
    return wish_m, least_m


def _rougher(counts: Sequence[int], goal: float) -> float:
    """How many times the finest size has a goal of voxels, by the counts at its doublings."""
    if counts[0] <= goal:
        # A finer size serves: the number of voxels on surfaces grows with 1 / size^2.
        return float(np.sqrt(counts[0] / goal))
    return float(2 ** np.interp(-np.log(goal), -np.log(counts), np.arange(len(counts))))


def _middle_and_spread(points_m: FloatArray, T_own_points: FloatArray) -> tuple[FloatArray, float]:
    """Robust middle of a scan and how far the scan spreads about it, from a sample of its points.

    Returns:
        (4, 4) motion from the points' frame to one with the principal axes and the median as its
        origin, and the distance within which three quarters of the points lie from there.
    """
    if len(points_m) > _SAMPLE:
        chosen = np.random.default_rng(0).integers(len(points_m), size=_SAMPLE)
        points_m = points_m.take(chosen, axis=0)
    own_m = np.ascontiguousarray(transform_points(T_own_points, points_m).T)
    middle_m = np.array([_quantile(axis_m, 0.5) for axis_m in own_m])
    own_m -= middle_m[:, None]
    spread_m = np.sqrt(_quantile(np.einsum("ij,ij->j", own_m, own_m), 0.75))
    return make_transform(np.eye(3), -middle_m) @ T_own_points, float(spread_m)


def _quantile(values: FloatArray, share: float) -> float:
    """The value that a share of (N,) values lies below; of two that might be it, one."""
    place = int(share * (len(values) - 1))
    return float(np.partition(values, place)[place])


@compiled
def _reach_m(points_m: FloatArray, T_middle_points: FloatArray) -> float:
    """How far the farthest point lies from the middle."""
    farthest_m2, T = 0.0, T_middle_points
    for i in range(len(points_m)):
        x_m, y_m, z_m = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        x = T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3]
        y = T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3]
        z = T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3]
        square_m2 = x * x + y * y + z * z
        if square_m2 > farthest_m2:  # hardly ever, and nobody waits for the last one's maximum
            farthest_m2 = square_m2
    return np.sqrt(farthest_m2)
