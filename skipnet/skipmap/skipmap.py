"""The Skip-map: the effective voxels of a scan with their curvature and oriented normals.

The paper's "variable resolution point cloud simplification": a voxel is effective when it and its
26 neighbours hold enough points, not all on one line, to fit a surface; PCA over that neighbourhood
gives curvature and normal. Voxel centres coloured by curvature are the paper's Skip-map picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.cells import pack, unpack
from skipnet.skipmap.moments import add_neighbours, curvature, principal_axes
from skipnet.skipmap.tree import SkipTree, build_tree
from skipnet.types import FloatArray, IntArray

MIN_NEIGHBOURHOOD_POINTS = 6
"""Fewer points in 3x3x3 voxels fit almost any plane: three define one, the rest must confirm it."""

MIN_WIDTH = 0.15
"""Least width of a neighbourhood, as a share of its length: one scan line alone has no normal."""

_COLUMN_STEPS = pack(np.array([(x, y, 0) for x in (-1, 0, 1) for y in (-1, 0, 1)])) - pack(
    np.zeros(3, dtype=np.int64)
)


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
    normals: FloatArray
    """(V, 3) unit normals, towards the sensor; of either sign if the viewpoint is unknown."""
    directions: FloatArray
    """(V, 3) unit directions in which the neighbourhood extends farthest, of either sign."""
    curvatures: FloatArray
    """(V,) l0 / (l0 + l1 + l2): 0 flat, 1/3 a ball."""
    table: CellTable
    """The row of the effective voxel in each cell."""
    viewpoint_m: FloatArray | None
    """(3,) sensor position in the scan's frame; None when unknown."""

    def __len__(self) -> int:
        return len(self.keys)

    def __str__(self) -> str:
        return f"{len(self):,} effective voxels of {self.voxel_size_m:.4g} m"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    @property
    def cells(self) -> IntArray:
        """(V, 3) int64 cells."""
        return unpack(self.keys)

    def find_around(self, rows: IntArray, steps: IntArray) -> IntArray:
        """(K, O) rows of the effective voxels (O, 3) cells away from (K,) ones; -1 for none."""
        return self.table.find_around(self.cells[rows], steps)

    def seen_from(self, viewpoint_m: FloatArray | None) -> SkipMap:
        """The same map with normals towards (3,) ``viewpoint_m``; None forgets the viewpoint."""
        if viewpoint_m is None:
            return replace(self, viewpoint_m=None)
        viewpoint_m = np.asarray(viewpoint_m, dtype=np.float64)
        normals = _turned_towards(self.normals, self.centroids_m, viewpoint_m)
        return replace(self, normals=normals, viewpoint_m=viewpoint_m)


def build_skipmap(
    points_m: FloatArray,
    voxel_size_m: float,
    viewpoint_m: FloatArray | None = None,
    min_points: int = MIN_NEIGHBOURHOOD_POINTS,
) -> SkipMap:
    """Divide a scan into voxels and describe the effective ones, from the voxels' moments alone.

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
    around = add_neighbours(tree.moments, tree.keys, _COLUMN_STEPS)
    eigenvalues_m2, axes = principal_axes(around)
    is_surface = eigenvalues_m2[:, 1] > MIN_WIDTH**2 * eigenvalues_m2[:, 2]
    effective = np.flatnonzero((around.count >= min_points) & is_surface)
    eigenvalues_m2 = eigenvalues_m2.take(effective, axis=0)
    keys = tree.keys[effective]
    skipmap = SkipMap(
        voxel_size_m=tree.voxel_size_m,
        origin_m=tree.origin_m,
        keys=keys,
        counts=tree.moments.count[effective],
        centroids_m=tree.centroids_m[effective],
        eigenvalues_m2=eigenvalues_m2,
        normals=axes[effective, :, 0],
        directions=axes[effective, :, 2],
        curvatures=curvature(eigenvalues_m2),
        table=CellTable(unpack(keys), tree.voxel_size_m, tree.origin_m),
        viewpoint_m=None,
    )
    return skipmap.seen_from(viewpoint_m)


@compiled
def _turned_towards(
    normals: FloatArray, centroids_m: FloatArray, viewpoint_m: FloatArray
) -> FloatArray:
    """(V, 3) normals turned towards a place."""
    turned = normals.copy()
    for v in range(len(normals)):
        towards = 0.0
        for i in range(3):
            towards += normals[v, i] * (viewpoint_m[i] - centroids_m[v, i])
        if towards < 0:
            for i in range(3):
                turned[v, i] = -normals[v, i]
    return turned
