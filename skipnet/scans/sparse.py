"""Scans of few lines, thinned and with trees for GICP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skipnet.types import FloatArray

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud

NEIGHBOURS = 10
"""Points that make a surface: enough to bridge two scan lines."""


def thin(points_m: FloatArray, voxel_size_m: float) -> tuple[PointCloud, KdTree]:
    """Thin (N, 3) points to one per voxel, with covariances and a search tree (small_gicp)."""
    from small_gicp import preprocess_points

    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    return preprocess_points(points_m, voxel_size_m, NEIGHBOURS)
