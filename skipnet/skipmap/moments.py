"""Additive moments of point sets: what a voxel keeps instead of its points.

Count, sum and sum of outer products add up when voxels merge and subtract when a scan is removed,
so a coarser level or a 3x3x3 neighbourhood never needs the points again. Curvature and normal
follow from the covariance's eigenvalues (PCA), as in the paper: l0 / (l0 + l1 + l2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.types import BoolArray, FloatArray, IntArray

_ROW = np.array([0, 0, 0, 1, 1, 2])
_COLUMN = np.array([0, 1, 2, 1, 2, 2])
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True)
class Moments:
    """Sums over the points of V voxels, all about one common origin."""

    count: FloatArray
    """(V,) number of points."""
    first: FloatArray
    """(V, 3) sum of p, metres."""
    second: FloatArray
    """(V, 6) sum of p p^T as xx, xy, xz, yy, yz, zz, square metres."""

    def __len__(self) -> int:
        return len(self.count)

    def __add__(self, other: Moments) -> Moments:
        return Moments(
            self.count + other.count, self.first + other.first, self.second + other.second
        )

    def __sub__(self, other: Moments) -> Moments:
        return Moments(
            self.count - other.count, self.first - other.first, self.second - other.second
        )

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> Moments:
        return Moments(self.count[rows], self.first[rows], self.second[rows])

    @property
    def mean(self) -> FloatArray:
        """(V, 3) centroids about the common origin, metres."""
        return self.first / self.count[:, None]

    @property
    def covariance(self) -> FloatArray:
        """(V, 3, 3) covariances (divided by the count), square metres."""
        mean = self.mean
        compact = self.second / self.count[:, None] - mean[:, _ROW] * mean[:, _COLUMN]
        return compact[:, _FULL]


def moments_of_points(points_m: FloatArray) -> Moments:
    """Moments of N single points, one row each, about the points' own origin."""
    points = np.asarray(points_m, dtype=np.float64)
    return Moments(np.ones(len(points)), points, points[:, _ROW] * points[:, _COLUMN])


def sum_segments(moments: Moments, starts: IntArray) -> Moments:
    """Add up consecutive rows; segment i runs from ``starts[i]`` to ``starts[i + 1]``."""
    return Moments(
        np.add.reduceat(moments.count, starts),
        np.add.reduceat(moments.first, starts, axis=0),
        np.add.reduceat(moments.second, starts, axis=0),
    )


def principal_axes(moments: Moments) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of every voxel's covariance (PCA).

    Returns:
        (V, 3) eigenvalues l0 <= l1 <= l2 in square metres, never negative, and (V, 3, 3) matrices
        whose column k is the unit eigenvector of l_k; column 0 is the surface normal up to its
        sign.
    """
    values, vectors = np.linalg.eigh(moments.covariance)
    return np.clip(values, 0.0, None), vectors


def curvature(eigenvalues_m2: FloatArray) -> FloatArray:
    """The paper's curvature l0 / (l0 + l1 + l2) of (V, 3) ascending eigenvalues.

    0 is a perfect plane, 1/3 a ball. A voxel whose points coincide counts as flat (0).
    """
    total = eigenvalues_m2.sum(axis=1)
    return np.divide(eigenvalues_m2[:, 0], total, out=np.zeros(len(total)), where=total > 0)
