"""Scans of few lines, thinned and with what GICP needs to know of each point."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from skipnet.geometry import make_transform
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.cells import occupied_cells, unpack
from skipnet.types import FloatArray, IntArray

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud

_ROUNDED_UP = 1 + 1e-9
"""So that no point that is just in reach seems to lie in the cell but one."""
_ACROSS = 1e-3
"""Variance across a surface, of 1 within it, that small_gicp takes."""
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
    _tables: dict[float, CellTable] = field(default_factory=dict, repr=False, compare=False)
    """By reach, as they are asked for."""

    def nearest(self, points_m: FloatArray, reach_m: float) -> IntArray:
        """(P,) row of the point nearest to each of (P, 3) others; -1 if none is in reach.

        Far from all points a search tree takes longest: where a table of cells as long as the reach
        shows none about, it is not asked.
        """
        asked = np.flatnonzero(self._table(reach_m).find_moved(np.eye(4)[None], points_m)[0] >= 0)
        found = np.full(len(points_m), -1)
        if len(asked):
            rows, squared_m2 = self.tree.batch_nearest_neighbor_search(points_m[asked])
            found[asked] = np.where(np.array(squared_m2) < reach_m**2, np.array(rows), -1)
        return found

    def _table(self, reach_m: float) -> CellTable:
        """Of the points in cells of this size and those about them."""
        if reach_m not in self._tables:
            edge_m, origin_m = reach_m * _ROUNDED_UP, self.points_m.min(axis=0)
            to_corner = make_transform(np.eye(3), -origin_m)
            cells = unpack(occupied_cells(self.points_m, edge_m, to_corner))
            self._tables[reach_m] = CellTable(cells, edge_m, origin_m, with_neighbours=True)
        return self._tables[reach_m]


def thin(points_m: FloatArray, voxel_size_m: float) -> Thinned:
    """Thin (N, 3) points to one per voxel, with covariances and a search tree (small_gicp)."""
    from small_gicp import preprocess_points

    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    cloud, tree = preprocess_points(points_m, voxel_size_m, NEIGHBOURS)
    kept_m = np.ascontiguousarray(np.asarray(cloud.points())[:, :3])
    # As the cloud's own, which come as a list of arrays: 1 within the surface, little across.
    normals = np.asarray(cloud.normals())[:, :3]
    covariances = np.eye(3) - (1 - _ACROSS) * normals[:, :, None] * normals[:, None]
    return Thinned(cloud, tree, kept_m, covariances)
