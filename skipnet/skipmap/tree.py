"""The skip-tree: voxels behind an X list, a Y list and a Z list, held as sorted arrays.

SkiMap (De Gregorio & Di Stefano, arXiv 1704.05832) keeps a tree of skip lists, X list -> Y list ->
Z list -> voxel. Here each list is a run of one sorted array of packed cells: a key's upper bits
name its X slice, the middle ones its Y column, the lower ones its place in the Z list. Descending
the tree is a binary search in a run; integrating a scan is one pass through a hash table, one sort
of voxels and one sum. Trees are values: every operation returns a new one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skipnet.clouds.statistics import as_floats, bounds
from skipnet.geometry import make_transform, transform_points
from skipnet.skipmap.cells import cells_of, group_by_cell, halve, pack, unpack
from skipnet.skipmap.grouping import CELL_MAX, CELL_MIN, group_keys
from skipnet.skipmap.moments import Moments, add_up, sum_groups
from skipnet.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class SkipTree:
    """Voxels of one resolution with their additive moments."""

    voxel_size_m: float
    origin_m: FloatArray
    """(3,) corner of cell (0, 0, 0); the moments are sums about it."""
    keys: IntArray
    """(V,) packed cells, strictly ascending: by x, then y, then z."""
    moments: Moments
    """Of the V voxels, in the order of ``keys``."""

    def __len__(self) -> int:
        return len(self.keys)

    def __getitem__(self, rows: IntArray | BoolArray) -> SkipTree:
        """The tree of some of the voxels: ascending rows, or a mask."""
        return replace(self, keys=self.keys[rows], moments=self.moments[rows])

    @property
    def cells(self) -> IntArray:
        """(V, 3) int64 cells in the tree's order."""
        return unpack(self.keys)

    @property
    def centroids_m(self) -> FloatArray:
        """(V, 3) mean of each voxel's points, in the frame of the points."""
        return self.moments.mean + self.origin_m

    def find(self, cells: IntArray) -> IntArray:
        """Exact lookup: the row of each (..., 3) cell, -1 where the tree has no such voxel."""
        keys = pack(cells)
        rows = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return np.where(self.keys[rows] == keys, rows, -1)

    def integrate(self, points_m: FloatArray) -> SkipTree:
        """Find-or-insert the voxels of (N, 3) points and add the points to them."""
        return self.add(build_tree(points_m, self.voxel_size_m, self.origin_m))

    def add(self, other: SkipTree) -> SkipTree:
        """The tree of both trees' points.

        Raises:
            ValueError: the trees differ in voxel size or origin.
        """
        return merge_trees([self, other])

    def remove(self, other: SkipTree) -> SkipTree:
        """Take a scan that was added out again; voxels left without a point disappear.

        Raises:
            ValueError: the grids differ, or ``other`` holds points that this tree does not.
        """
        _check_same_grid(self, other)
        rows = self.find(other.cells)
        if (rows < 0).any() or (self.moments.count[rows] < other.moments.count).any():
            raise ValueError("the scan to remove has points that this tree never integrated")
        sums = self.moments.sums.copy()
        sums[rows] -= other.moments.sums
        left = sums[:, 0] > 0
        return SkipTree(self.voxel_size_m, self.origin_m, self.keys[left], Moments(sums[left]))

    def coarser(self, levels: int = 1) -> SkipTree:
        """The tree of voxels 2**levels times as wide, from the moments alone."""
        keys = self.keys
        for _ in range(levels):
            keys = halve(keys)
        return _gather(self.voxel_size_m * 2**levels, self.origin_m, keys, self.moments)

    def box(self, low_m: FloatArray, high_m: FloatArray) -> IntArray:
        """Rows of the voxels whose cells meet the closed box [low, high], ascending.

        Descends the tree: the X list gives the slices, their Y lists the columns, their Z lists
        the voxels, each by binary search.
        """
        low, high = (
            cells_of(np.asarray(corner_m), self.voxel_size_m, self.origin_m)
            for corner_m in (low_m, high_m)
        )
        prefixes = np.zeros((1, 0), dtype=np.int64)
        for axis in range(3):
            rows = self._rows_between(prefixes, low[axis], high[axis])
            prefixes = np.unique(unpack(self.keys[rows])[:, : axis + 1], axis=0)
        return rows

    def _rows_between(self, prefixes: IntArray, low: int, high: int) -> IntArray:
        """Rows whose cell starts with one of the prefixes and goes on with low <= value <= high."""
        depth = prefixes.shape[1]
        first = np.full((len(prefixes), 3), CELL_MIN)
        last = np.full((len(prefixes), 3), CELL_MAX)
        first[:, :depth] = last[:, :depth] = prefixes
        first[:, depth], last[:, depth] = low, high
        starts = np.searchsorted(self.keys, pack(first), side="left")
        return _ranges(starts, np.searchsorted(self.keys, pack(last), side="right"))

    def radius(self, centre_m: FloatArray, radius_m: float) -> IntArray:
        """Rows of the voxels with centroids within ``radius_m`` of the (3,) centre, ascending."""
        centre_m = np.asarray(centre_m)
        rows = self.box(centre_m - radius_m, centre_m + radius_m)
        offset_m = self.moments[rows].mean + self.origin_m - centre_m
        return rows[np.einsum("ij,ij->i", offset_m, offset_m) <= radius_m**2]

    def project_2d(self) -> tuple[IntArray, FloatArray]:
        """Seen from above: the (C, 2) occupied columns and the (C,) number of points in each."""
        columns, starts = self._columns()
        return columns, np.add.reduceat(self.moments.count, starts)

    def project_2_5d(self) -> tuple[IntArray, FloatArray]:
        """A height map: (C, 2) occupied columns and (C,) centroid heights of their top voxels."""
        columns, starts = self._columns()
        tops = np.append(starts[1:], len(self.keys)) - 1
        return columns, self.moments[tops].mean[:, 2] + self.origin_m[2]

    def _columns(self) -> tuple[IntArray, IntArray]:
        cells = self.cells
        starts = np.flatnonzero(np.r_[True, (cells[1:, :2] != cells[:-1, :2]).any(axis=1)])
        return cells[starts, :2], starts


Points = FloatArray | SkipTree
"""A scan: (N, 3) points, or voxels so fine that their moments can stand for these."""


def points_of(cloud_m: Points) -> FloatArray:
    """What stands for a scan's points: (N, 3) they themselves, or the centroids of its voxels."""
    return cloud_m.centroids_m if isinstance(cloud_m, SkipTree) else cloud_m


def build_tree(
    points_m: Points,
    voxel_size_m: float,
    origin_m: FloatArray | None = None,
    T_tree_points: FloatArray | None = None,
) -> SkipTree:
    """Divide (N, 3) points into voxels of ``voxel_size_m``.

    Args:
        points_m: (N, 3) points, at least one; or a tree of finer voxels, each of which goes,
            moments and all, into the voxel that holds its centroid.
        voxel_size_m: edge of a voxel.
        origin_m: (3,) corner of cell (0, 0, 0). Trees that are to be added need the same one.
            Default: the whole metre nearest to the points' centre, which keeps float64 sums exact
            enough anywhere.
        T_tree_points: (4, 4) motion of the points before they are divided; None for none.

    Raises:
        ValueError: no points, a voxel size that is not positive, or points too far from the origin.
    """
    if not isinstance(points_m, SkipTree):
        shape = np.shape(points_m)
        if len(shape) != 2 or shape[1] != 3:
            raise ValueError(f"points_m: got shape {shape}: expected numbers of shape (N, 3)")
        points_m = as_floats(points_m)
    if len(points_m) == 0:
        raise ValueError("a skip-tree needs at least one point, none was given")
    check_voxel_size(voxel_size_m)
    if origin_m is None:
        origin_m = _default_origin_m(points_of(points_m), T_tree_points)
    if isinstance(points_m, SkipTree):
        return _regrid(points_m, voxel_size_m, origin_m, T_tree_points)
    T_tree_points = np.eye(4) if T_tree_points is None else T_tree_points
    T_grid_points = make_transform(np.eye(3), -np.asarray(origin_m)) @ T_tree_points
    keys, row = group_by_cell(points_m, voxel_size_m, T_grid_points)
    moments = sum_groups(points_m, row, len(keys), T_grid_points)
    return SkipTree(voxel_size_m, origin_m, keys, moments)


def check_voxel_size(voxel_size_m: object) -> None:
    """Refuse what is no voxel size.

    Raises:
        ValueError: not a positive finite number.
    """
    if not (isinstance(voxel_size_m, (int, float, np.number)) and 0 < voxel_size_m < np.inf):
        raise ValueError(f"voxel_size_m={voxel_size_m!r}: expected a positive length in metres")


def merge_trees(trees: Sequence[SkipTree]) -> SkipTree:
    """The tree of all trees' points, one or more.

    Raises:
        ValueError: the trees differ in voxel size or origin.
    """
    first = trees[0]
    for other in trees[1:]:
        _check_same_grid(first, other)
    keys = np.concatenate([tree.keys for tree in trees])
    moments = Moments(np.concatenate([tree.moments.sums for tree in trees]))
    return _gather(first.voxel_size_m, first.origin_m, keys, moments)


def _default_origin_m(points_m: FloatArray, T_tree_points: FloatArray | None) -> FloatArray:
    low_m, high_m = bounds(points_m)
    middle_m = 0.5 * (low_m + high_m)
    if T_tree_points is not None:
        middle_m = transform_points(T_tree_points, middle_m[None])[0]
    return np.round(middle_m)


def _regrid(
    tree: SkipTree, voxel_size_m: float, origin_m: FloatArray, T_new_old: FloatArray | None
) -> SkipTree:
    """The tree's voxels moved and put into those of another grid."""
    T_new_old = np.eye(4) if T_new_old is None else T_new_old
    shift_m = transform_points(T_new_old, tree.origin_m[None])[0] - origin_m
    moments = tree.moments.moved(T_new_old[:3, :3], shift_m)
    keys, row = group_by_cell(moments.mean, voxel_size_m, np.eye(4))
    return SkipTree(voxel_size_m, origin_m, keys, add_up(moments, row, len(keys)))


def _gather(
    voxel_size_m: float, origin_m: FloatArray, keys: IntArray, moments: Moments
) -> SkipTree:
    """Add up the voxels that share a key, and sort by key."""
    distinct, row = group_keys(keys)
    return SkipTree(voxel_size_m, origin_m, distinct, add_up(moments, row, len(distinct)))


def _check_same_grid(a: SkipTree, b: SkipTree) -> None:
    if a.voxel_size_m != b.voxel_size_m or not np.array_equal(a.origin_m, b.origin_m):
        raise ValueError(
            f"the trees have different grids: voxels of {a.voxel_size_m:g} m at {a.origin_m} and "
            f"of {b.voxel_size_m:g} m at {b.origin_m}; build both with the same voxel_size_m and "
            "origin_m"
        )


def _ranges(starts: IntArray, stops: IntArray) -> IntArray:
    """Concatenate the half-open ranges [start, stop)."""
    lengths = stops - starts
    if lengths.sum() == 0:
        return np.zeros(0, dtype=np.int64)
    offsets = np.repeat(starts - np.r_[0, np.cumsum(lengths)[:-1]], lengths)
    return np.arange(lengths.sum()) + offsets
