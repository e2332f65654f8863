"""The one length a user may set, found in the data: the voxel size."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import invert, principal_frame, transform_points
from skipnet.skipmap.cells import CELL_MAX, cells_of, pack, unpack
from skipnet.types import FloatArray

TARGET_VOXELS = 10_000
"""Occupied voxels that describe one scan well: 0.15 m voxels in a furnished 10 m room."""
MIN_POINTS_PER_VOXEL = 5
"""Mean points per voxel below which curvature and normals are guesses."""


def choose_voxel_size(*clouds_m: FloatArray) -> float:
    """The voxel size for scans of one scene, from their own extent and density.

    Each scan asks for the size at which it occupies ``TARGET_VOXELS`` voxels, or fewer where it is
    too sparse for that; the largest of these sizes serves all. Moving a scan rigidly does
    not matter.

    Args:
        clouds_m: (N, 3) points of each scan.

    Returns:
        Voxel size in the points' unit, to two digits: small changes of the input leave it alone.
    """
    size_m = max(_size_for_one(points_m) for points_m in clouds_m)
    return float(f"{size_m:.2g}")


def _size_for_one(points_m: FloatArray) -> float:
    """Count occupied voxels over doubling sizes and interpolate to the goal, both logarithmic."""
    goal = min(TARGET_VOXELS, len(points_m) / MIN_POINTS_PER_VOXEL)
    points_m = transform_points(invert(principal_frame(points_m)), points_m)
    centre_m = np.median(points_m, axis=0)
    distance_m = np.linalg.norm(points_m - centre_m, axis=1)
    spread_m = float(np.quantile(distance_m, 0.75)) or float(distance_m.max())
    finest_m = max(spread_m / 64, float(distance_m.max()) / CELL_MAX)
    cells = unpack(np.unique(pack(cells_of(points_m, finest_m, centre_m))))
    cells -= cells.min(axis=0)  # halved often enough, they all meet in cell 0
    counts = [len(cells)]
    while counts[-1] > max(goal, 1):
        cells = unpack(np.unique(pack(cells >> 1)))
        counts.append(len(cells))
    if len(counts) == 1:
        # A finer size serves: the number of voxels on surfaces grows with 1 / size^2.
        return finest_m * float(np.sqrt(counts[0] / goal))
    doublings = np.interp(-np.log(goal), -np.log(counts), np.arange(len(counts)))
    return finest_m * float(2**doublings)
