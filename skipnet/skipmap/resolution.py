"""The one length a user may set, found in the data: the voxel size."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import reduce

import numpy as np

from skipnet.geometry import columns, invert, make_transform, principal_frame, transform_points
from skipnet.skipmap.cells import CELL_MAX, POINTS_AT_ONCE, distinct_cells, occupied_cells
from skipnet.types import FloatArray, IntArray

TARGET_VOXELS = 10_000
"""Occupied voxels that describe one scan well: 0.15 m voxels in a furnished 10 m room."""
MIN_POINTS_PER_VOXEL = 5
"""Mean points per voxel below which curvature and normals are guesses."""

_SAMPLE = 1 << 15
"""Points that tell how far a larger scan spreads."""


def choose_voxel_size(
    *clouds_m: FloatArray, T_given_own: Sequence[FloatArray] | None = None
) -> float:
    """The voxel size for scans of one scene, from their own extent and density.

    Each scan asks for the size at which it occupies ``TARGET_VOXELS`` voxels, or fewer where it is
    too sparse for that; the largest of these sizes serves all. Moving a scan rigidly does
    not matter.

    Args:
        clouds_m: (N, 3) points of each scan.
        T_given_own: (4, 4) ``principal_frame`` of each scan, where it is known already.

    Returns:
        Voxel size in the points' unit, to two digits: small changes of the input leave it alone.
    """
    frames = T_given_own or [principal_frame(points_m) for points_m in clouds_m]
    with ThreadPoolExecutor() as pool:
        sizes_m = pool.map(_size_for_one, clouds_m, [invert(frame) for frame in frames])
        return float(f"{max(sizes_m):.2g}")


def _size_for_one(points_m: FloatArray, T_own_points: FloatArray) -> float:
    """Count occupied voxels over doubling sizes and interpolate to the goal, both logarithmic."""
    goal = min(TARGET_VOXELS, len(points_m) / MIN_POINTS_PER_VOXEL)
    T_middle_points, spread_m = _middle_and_spread(points_m, T_own_points)
    reach_m = _reach_m(points_m, T_middle_points)
    spread_m = spread_m or reach_m
    finest_m = max(spread_m / 64, reach_m / CELL_MAX)
    cells = _occupied_cells(points_m, T_middle_points, finest_m)
    # From their own lowest corner up: halved often enough, all cells meet in one.
    cells -= cells.min(axis=1, keepdims=True)
    counts = [cells.shape[1]]
    while counts[-1] > max(goal, 1):
        cells = distinct_cells(cells >> 1)
        counts.append(cells.shape[1])
    if len(counts) == 1:
        # A finer size serves: the number of voxels on surfaces grows with 1 / size^2.
        return finest_m * float(np.sqrt(counts[0] / goal))
    doublings = np.interp(-np.log(goal), -np.log(counts), np.arange(len(counts)))
    return finest_m * float(2**doublings)


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
    middle_m = np.array([np.median(axis_m) for axis_m in own_m])
    own_m -= middle_m[:, None]
    spread_m = float(np.quantile(np.sqrt(np.einsum("ij,ij->j", own_m, own_m)), 0.75))
    return make_transform(np.eye(3), -middle_m) @ T_own_points, spread_m


def _reach_m(points_m: FloatArray, T_middle_points: FloatArray) -> float:
    """How far the farthest point lies from the middle."""
    return max(
        float(np.sqrt(np.einsum("ij,ij->j", xyz_m, xyz_m).max()))
        for xyz_m in columns(points_m, T_middle_points)
    )


def _occupied_cells(
    points_m: FloatArray, T_middle_points: FloatArray, voxel_size_m: float
) -> IntArray:
    """(3, G) cells that hold points."""
    chunks = (
        occupied_cells(xyz_m, voxel_size_m)
        for xyz_m in columns(points_m, T_middle_points, POINTS_AT_ONCE)
    )
    return reduce(lambda seen, new: distinct_cells(np.concatenate([seen, new], axis=1)), chunks)
