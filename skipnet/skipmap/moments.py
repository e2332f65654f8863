"""Additive moments of point sets: what a voxel keeps instead of its points.

Count, sum and sum of outer products add up when voxels merge and subtract when a scan is removed,
so a coarser level or a 3x3x3 neighbourhood never needs the points again. Curvature and normal
follow from the covariance's eigenvalues (PCA), as in the paper: l0 / (l0 + l1 + l2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.skipmap.eigen import symmetric_eigh
from skipnet.types import BoolArray, FloatArray, IntArray

_ROW = (0, 0, 0, 1, 1, 2)
_COLUMN = (0, 1, 2, 1, 2, 2)
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True)
class Moments:
    """Sums over the points of V voxels, all about one common origin."""

    sums: FloatArray
    """(10, V) number of points; sums of x, y, z in metres; sums of xx, xy, xz, yy, yz, zz in square
    metres. One row per figure: whatever is done to all voxels runs through memory in order."""

    def __len__(self) -> int:
        return self.sums.shape[1]

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.sums + other.sums)

    def __sub__(self, other: Moments) -> Moments:
        return Moments(self.sums - other.sums)

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> Moments:
        if isinstance(rows, slice):
            return Moments(self.sums[:, rows])
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        return Moments(self.sums.take(rows, axis=1))

    def moved(self, rotation: FloatArray, shift_m: FloatArray) -> Moments:
        """Of the same points after p -> rotation p + shift: (3, 3) and (3,)."""
        count, first = self.sums[0], rotation @ self.sums[1:4]
        shift = shift_m[:, None]
        second = np.einsum("ia,abv,jb->ijv", rotation, self.sums[4:][_FULL], rotation)
        mixed = first[:, None] * shift[None]
        second += mixed + mixed.swapaxes(0, 1) + count * (shift[:, None] * shift[None])
        return Moments(np.concatenate([[count], first + count * shift, second[_ROW, _COLUMN]]))

    @property
    def count(self) -> FloatArray:
        """(V,) number of points."""
        return self.sums[0]

    @property
    def first(self) -> FloatArray:
        """(V, 3) sum of p, metres."""
        return self.sums[1:4].T

    @property
    def second(self) -> FloatArray:
        """(V, 6) sum of p p^T as xx, xy, xz, yy, yz, zz, square metres."""
        return self.sums[4:].T

    @property
    def mean(self) -> FloatArray:
        """(V, 3) centroids about the common origin, metres."""
        return self.first / self.count[:, None]

    @property
    def covariance(self) -> FloatArray:
        """(V, 3, 3) covariances (divided by the count), square metres."""
        return self._six_covariances().T[:, _FULL]

    def _six_covariances(self) -> FloatArray:
        """(6, V) as xx, xy, xz, yy, yz, zz."""
        means = self.sums[1:] / self.sums[0]
        for k, (i, j) in enumerate(zip(_ROW, _COLUMN, strict=True)):
            means[3 + k] -= means[i] * means[j]
        return means[3:]


def moments_of_points(points_m: FloatArray) -> Moments:
    """Moments of N single points, one column each, about the points' own origin."""
    sums = np.empty((10, len(points_m)))
    sums[0] = 1
    sums[1:4] = np.asarray(points_m).T
    np.multiply(sums[1:4].take(_ROW, axis=0), sums[1:4].take(_COLUMN, axis=0), out=sums[4:])
    return Moments(sums)


def sum_groups(xyz_m: FloatArray, group: IntArray, groups: int) -> Moments:
    """Moments of G groups of points: one pass over the points for each of the ten figures.

    Args:
        xyz_m: (3, N) float64 coordinates, metres.
        group: (N,) number of the group that each point belongs to, below ``groups``.
        groups: G.
    """
    group = group.astype(np.intp, copy=False)
    sums = np.empty((10, groups))
    sums[0] = np.bincount(group, minlength=groups)
    for axis in range(3):
        sums[1 + axis] = np.bincount(group, xyz_m[axis], groups)
    product = np.empty(xyz_m.shape[1])
    for k, (i, j) in enumerate(zip(_ROW, _COLUMN, strict=True)):
        np.multiply(xyz_m[i], xyz_m[j], out=product)
        sums[4 + k] = np.bincount(group, product, groups)
    return Moments(sums)


def add_up(moments: Moments, group: IntArray, groups: int) -> Moments:
    """Add voxels up to G groups; (V,) ``group`` says to which one each belongs."""
    sums = np.empty((10, groups))
    for figure, total in zip(moments.sums, sums, strict=True):
        total[:] = np.bincount(group, figure, groups)
    return Moments(sums)


def principal_axes(moments: Moments) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of every voxel's covariance (PCA).

    Returns:
        (V, 3) eigenvalues l0 <= l1 <= l2 in square metres, never negative, and (V, 3, 3) matrices
        whose column k is the unit eigenvector of l_k; column 0 is the surface normal up to its
        sign.
    """
    values, vectors = symmetric_eigh(moments._six_covariances())
    return np.clip(values, 0.0, None), vectors


def curvature(eigenvalues_m2: FloatArray) -> FloatArray:
    """The paper's curvature l0 / (l0 + l1 + l2) of (V, 3) ascending eigenvalues.

    0 is a perfect plane, 1/3 a ball. A voxel whose points coincide counts as flat (0).
    """
    total = eigenvalues_m2.sum(axis=1)
    return np.divide(eigenvalues_m2[:, 0], total, out=np.zeros(len(total)), where=total > 0)
