"""The Skip-map: the effective voxels of a scan with their curvature and oriented normals.

The paper's "variable resolution point cloud simplification": a voxel is effective when it and its
26 neighbours hold enough points, not all on one line, to fit a surface; PCA over that neighbourhood
gives curvature and normal. Voxel centres coloured by curvature are the paper's Skip-map picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from skipnet.skipmap.cells import CellIndex, neighbour_rows, pack, unpack
from skipnet.skipmap.moments import Moments, curvature, principal_axes
from skipnet.skipmap.tree import SkipTree, build_tree
from skipnet.types import FloatArray, IntArray

MIN_NEIGHBOURHOOD_POINTS = 6
"""Fewer points in 3x3x3 voxels fit almost any plane: three define one, the rest must confirm it."""

MIN_WIDTH = 0.15
"""Least width of a neighbourhood, as a share of its length: one scan line alone has no normal."""

_NEIGHBOURHOOD = np.array(list(np.ndindex(3, 3, 3))) - 1


@dataclass(frozen=True)
class SkipMap:
    """Effective voxels of one scan at one resolution, all arrays in the tree's order."""

    voxel_size_m: float
    origin_m: FloatArray
    """(3,) corner of cell (0, 0, 0) in the scan's frame."""
    keys: IntArray
    """(V,) packed cells, ascending."""
    counts: FloatArray
    """(V,) points in the voxel itself."""
    centroids_m: FloatArray
    """(V, 3) mean of the voxel's own points, scan frame."""
    eigenvalues_m2: FloatArray
    """(V, 3) ascending, of the 3x3x3 neighbourhood's covariance."""
    axes: FloatArray
    """(V, 3, 3) unit eigenvectors in columns, of ascending eigenvalue; column 0 is the normal."""
    curvatures: FloatArray
    """(V,) l0 / (l0 + l1 + l2): 0 flat, 1/3 a ball."""
    viewpoint_m: FloatArray | None
    """(3,) sensor position in the scan's frame; None when unknown."""

    def __len__(self) -> int:
        return len(self.keys)

    @property
    def cells(self) -> IntArray:
        """(V, 3) int64 cells."""
        return unpack(self.keys)

    @cached_property
    def normals(self) -> FloatArray:
        """(V, 3) unit normals, towards the sensor; of either sign if the viewpoint is unknown."""
        return np.ascontiguousarray(self.axes[:, :, 0])

    @cached_property
    def _index(self) -> CellIndex:
        return CellIndex(self.keys)

    def find(self, cells: IntArray) -> IntArray:
        """Row of each (..., 3) cell, -1 where there is no effective voxel."""
        return self.find_keys(pack(cells))

    def find_keys(self, keys: IntArray) -> IntArray:
        """As ``find``, for cells that are packed already."""
        return self._index.find(keys)

    def seen_from(self, viewpoint_m: FloatArray | None) -> SkipMap:
        """The same map with normals towards (3,) ``viewpoint_m``; None forgets the viewpoint."""
        if viewpoint_m is None:
            return replace(self, viewpoint_m=None)
        viewpoint_m = np.asarray(viewpoint_m, dtype=np.float64)
        away = np.einsum("vi,vi->v", self.normals, viewpoint_m - self.centroids_m) < 0
        axes = self.axes.copy()
        axes[away, :, 0] *= -1
        return replace(self, axes=axes, viewpoint_m=viewpoint_m)


def build_skipmap(
    points_m: FloatArray,
    voxel_size_m: float,
    viewpoint_m: FloatArray | None = None,
    min_points: int = MIN_NEIGHBOURHOOD_POINTS,
) -> SkipMap:
    """Divide a scan into voxels and describe the effective ones, in one pass over the points.

    Args:
        points_m: (N, 3) points in the scan's frame.
        voxel_size_m: edge of a voxel.
        viewpoint_m: (3,) sensor position in the same frame; normals are turned towards it.
        min_points: points that a voxel and its 26 neighbours must hold together to be effective.

    Raises:
        ValueError: as ``build_tree``.
    """
    return skipmap_of_tree(build_tree(points_m, voxel_size_m), viewpoint_m, min_points)


def skipmap_of_tree(
    tree: SkipTree,
    viewpoint_m: FloatArray | None = None,
    min_points: int = MIN_NEIGHBOURHOOD_POINTS,
) -> SkipMap:
    """The Skip-map of a tree at its own resolution; ``tree.coarser()`` has the next level."""
    around = _sum_neighbourhoods(tree)
    effective = np.flatnonzero(around.count >= min_points)
    eigenvalues_m2, axes = principal_axes(around[effective])
    surface = np.flatnonzero(eigenvalues_m2[:, 1] > MIN_WIDTH**2 * eigenvalues_m2[:, 2])
    effective = effective.take(surface)
    eigenvalues_m2, axes = (part.take(surface, axis=0) for part in (eigenvalues_m2, axes))
    skipmap = SkipMap(
        voxel_size_m=tree.voxel_size_m,
        origin_m=tree.origin_m,
        keys=tree.keys[effective],
        counts=tree.moments.count[effective],
        centroids_m=tree.centroids_m[effective],
        eigenvalues_m2=eigenvalues_m2,
        axes=axes,
        curvatures=curvature(eigenvalues_m2),
        viewpoint_m=None,
    )
    return skipmap.seen_from(viewpoint_m)


def _sum_neighbourhoods(tree: SkipTree) -> Moments:
    """Moments of every voxel's 3x3x3 neighbourhood, by addition."""
    from scipy.sparse import csr_array

    rows, ends = neighbour_rows(tree.keys, _NEIGHBOURHOOD)
    adjacent = csr_array((np.ones(len(rows)), rows, ends), shape=(len(tree), len(tree)))
    sums = adjacent @ np.ascontiguousarray(tree.moments.sums.T)
    return Moments(np.ascontiguousarray(sums.T))
