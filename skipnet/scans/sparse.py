"""Scans of few lines, thinned and with what GICP needs to know of each point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skipnet.types import FloatArray, IntArray

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud

NEIGHBOURS = 10
"""Points that make a surface: enough to bridge two scan lines."""


@dataclass(frozen=True)
class Thinned:
    """One point per voxel, each with the surface that its neighbours make."""

    cloud: PointCloud
    """small_gicp's; normals are of unit variance within the surface and next to none across."""
    tree: KdTree
    """Of the points."""
    points_m: FloatArray
    """(N, 3) float64, those of the cloud."""
    covariances: FloatArray
    """(N, 3, 3) likewise."""

    def nearest(self, points_m: FloatArray, reach_m: float) -> IntArray:
        """(P,) row of the point nearest to each of (P, 3) others; -1 if none is in reach."""
        rows, squared_m2 = self.tree.batch_nearest_neighbor_search(points_m)
        return np.where(np.array(squared_m2) < reach_m**2, np.array(rows), -1)


def thin(points_m: FloatArray, voxel_size_m: float) -> Thinned:
    """Thin (N, 3) points to one per voxel, with covariances and a search tree (small_gicp)."""
    from small_gicp import preprocess_points

    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    cloud, tree = preprocess_points(points_m, voxel_size_m, NEIGHBOURS)
    kept_m = np.ascontiguousarray(np.asarray(cloud.points())[:, :3])
    covariances = np.array(cloud.covs())[:, :3, :3]
    return Thinned(cloud, tree, kept_m, np.ascontiguousarray(covariances))
