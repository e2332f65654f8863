"""Additive moments of point sets: what a voxel keeps instead of its points.

Count, sum and sum of outer products add up when voxels merge and subtract when a scan is removed,
so a coarser level or a 3x3x3 neighbourhood never needs the points again. Curvature and normal
follow from the covariance's eigenvalues (PCA), as in the paper: l0 / (l0 + l1 + l2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.eigen import symmetric_eigh
from skipnet.types import BoolArray, FloatArray, IntArray

_ROW = (0, 0, 0, 1, 1, 2)
_COLUMN = (0, 1, 2, 1, 2, 2)
_PLACE = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
_FULL = np.array(_PLACE)


@dataclass(frozen=True)
class Moments:
    """Sums over the points of V voxels, all about one common origin."""

    sums: FloatArray
    """(V, 10) number of points; sums of x, y, z in metres; sums of xx, xy, xz, yy, yz, zz in square
    metres."""

    def __len__(self) -> int:
        return len(self.sums)

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.sums + other.sums)

    def __sub__(self, other: Moments) -> Moments:
        return Moments(self.sums - other.sums)

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> Moments:
        return Moments(self.sums[rows])

    def moved(self, rotation: FloatArray, shift_m: FloatArray) -> Moments:
        """Of the same points after p -> rotation p + shift: (3, 3) and (3,)."""
        return Moments(_move(self.sums, rotation, shift_m))

    @property
    def count(self) -> FloatArray:
        """(V,) number of points."""
        return self.sums[:, 0]

    @property
    def first(self) -> FloatArray:
        """(V, 3) sum of p, metres."""
        return self.sums[:, 1:4]

    @property
    def second(self) -> FloatArray:
        """(V, 6) sum of p p^T as xx, xy, xz, yy, yz, zz, square metres."""
        return self.sums[:, 4:]

    @property
    def mean(self) -> FloatArray:
        """(V, 3) centroids about the common origin, metres."""
        return self.first / self.count[:, None]

    @property
    def covariance(self) -> FloatArray:
        """(V, 3, 3) covariances (divided by the count), square metres."""
        return _six_covariances(self.sums)[:, _FULL]


def moments_of_points(points_m: FloatArray) -> Moments:
    """Moments of N single points, one row each, about the points' own origin."""
    return sum_groups(points_m, np.arange(len(points_m)), len(points_m))


def sum_groups(
    points_m: FloatArray, group: IntArray, groups: int, T_sums_points: FloatArray | None = None
) -> Moments:
    """Moments of G groups of points.

    Args:
        points_m: (N, 3) points.
        group: (N,) number of the group that each point belongs to, below ``groups``.
        groups: G.
        T_sums_points: (4, 4) motion of the points on the way; None for none.
    """
    T_sums_points = np.eye(4) if T_sums_points is None else T_sums_points
    return Moments(_sum_points(points_m, T_sums_points, group, groups))


def add_up(moments: Moments, group: IntArray, groups: int) -> Moments:
    """Add voxels up to G groups; (V,) ``group`` says to which one each belongs."""
    return Moments(_sum_rows(moments.sums, group, groups))


def add_neighbours(moments: Moments, keys: IntArray, column_steps: IntArray) -> Moments:
    """Add up each voxel and its 26 neighbours.

    Args:
        moments: of V voxels.
        keys: (V,) their packed cells, ascending.
        column_steps: (9,) from a packed cell to those of its 3 x 3 columns, ascending; along a
            column keys count up.
    """
    return Moments(_sum_columns(moments.sums, keys, column_steps))


def principal_axes(moments: Moments) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of every voxel's covariance (PCA).

    Returns:
        (V, 3) eigenvalues l0 <= l1 <= l2 in square metres, never negative, and (V, 3, 3) matrices
        whose column k is the unit eigenvector of l_k; column 0 is the surface normal up to its
        sign.
    """
    values, vectors = symmetric_eigh(_six_covariances(moments.sums))
    return np.maximum(values, 0.0, out=values), vectors


def curvature(eigenvalues_m2: FloatArray) -> FloatArray:
    """The paper's curvature l0 / (l0 + l1 + l2) of (V, 3) ascending eigenvalues.

    0 is a perfect plane, 1/3 a ball. A voxel whose points coincide counts as flat (0).
    """
    total = eigenvalues_m2.sum(axis=1)
    return np.divide(eigenvalues_m2[:, 0], total, out=np.zeros(len(total)), where=total > 0)


@compiled
def _six_covariances(sums: FloatArray) -> FloatArray:
    """(V, 6) as xx, xy, xz, yy, yz, zz."""
    six = np.empty((len(sums), 6))
    for v in range(len(sums)):
        count = sums[v, 0]
        for k in range(6):
            mean_i, mean_j = sums[v, 1 + _ROW[k]] / count, sums[v, 1 + _COLUMN[k]] / count
            six[v, k] = sums[v, 4 + k] / count - mean_i * mean_j
    return six


@compiled
def _sum_points(
    points_m: FloatArray, T_sums_points: FloatArray, group: IntArray, groups: int
) -> FloatArray:
    """(G, 10) sums over moved points."""
    sums, T = np.zeros((groups, 10)), T_sums_points
    for i in range(len(points_m)):
        x_m, y_m, z_m = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        x = T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3]
        y = T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3]
        z = T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3]
        own = sums[group[i]]
        own[0] += 1
        own[1] += x
        own[2] += y
        own[3] += z
        own[4] += x * x
        own[5] += x * y
        own[6] += x * z
        own[7] += y * y
        own[8] += y * z
        own[9] += z * z
    return sums


@compiled
def _sum_rows(sums: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """(G, 10) sums of (V, 10) ones."""
    total = np.zeros((groups, sums.shape[1]))
    for v in range(len(sums)):
        for figure in range(sums.shape[1]):
            total[group[v], figure] += sums[v, figure]
    return total


@compiled
def _sum_columns(sums: FloatArray, keys: IntArray, column_steps: IntArray) -> FloatArray:
    """See ``add_neighbours``. Keys are visited in ascending order, so those of each neighbouring
    column are found by walking on from where the last voxel's were."""
    around = np.empty_like(sums)
    place = np.zeros(len(column_steps), dtype=np.int64)
    for v in range(len(keys)):
        n = x = y = z = xx = xy = xz = yy = yz = zz = 0.0
        for column in range(len(column_steps)):
            middle = keys[v] + column_steps[column]
            row = place[column]
            while row < len(keys) and keys[row] < middle - 1:
                row += 1
            place[column] = row
            while row < len(keys) and keys[row] <= middle + 1:
                n, x, y, z = n + sums[row, 0], x + sums[row, 1], y + sums[row, 2], z + sums[row, 3]
                xx, xy, xz = xx + sums[row, 4], xy + sums[row, 5], xz + sums[row, 6]
                yy, yz, zz = yy + sums[row, 7], yz + sums[row, 8], zz + sums[row, 9]
                row += 1
        around[v, 0], around[v, 1], around[v, 2], around[v, 3] = n, x, y, z
        around[v, 4], around[v, 5], around[v, 6] = xx, xy, xz
        around[v, 7], around[v, 8], around[v, 9] = yy, yz, zz
    return around


@compiled
def _move(sums: FloatArray, rotation: FloatArray, shift_m: FloatArray) -> FloatArray:
    """See ``Moments.moved``."""
    moved = np.empty_like(sums)
    half = np.empty((3, 3))
    for v in range(len(sums)):
        count = moved[v, 0] = sums[v, 0]
        for i in range(3):
            moved[v, 1 + i] = 0.0
            for j in range(3):
                moved[v, 1 + i] += rotation[i, j] * sums[v, 1 + j]
                half[i, j] = 0.0  # of rotation @ second @ rotation.T, the first product
                for k in range(3):
                    half[i, j] += rotation[i, k] * sums[v, 4 + _PLACE[k][j]]
        for figure in range(6):
            i, j = _ROW[figure], _COLUMN[figure]
            turned = 0.0
            for k in range(3):
                turned += half[i, k] * rotation[j, k]
            mixed = moved[v, 1 + i] * shift_m[j] + shift_m[i] * moved[v, 1 + j]
            moved[v, 4 + figure] = turned + mixed + count * shift_m[i] * shift_m[j]
        for i in range(3):
            moved[v, 1 + i] += count * shift_m[i]
    return moved
