"""Moments and bounds of points, the frame that points carry with them, the largest of many."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skipnet.compiled import compiled
from skipnet.geometry import make_transform
from skipnet.types import FloatArray, IntArray

_BLOCK = 1 << 10
"""Points whose sums are taken on their own before they are added to the others': fewer digits are
lost."""
_SAMPLE = 1000
"""Points whose mean lies among them all."""
_PAIRS = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where xx, xy, xz, yy, yz, zz stand in a matrix ..."""
_TRIPLES = np.array(
    [
        [[0, 1, 2], [1, 3, 4], [2, 4, 5]],
        [[1, 3, 4], [3, 6, 7], [4, 7, 8]],
        [[2, 4, 5], [4, 7, 8], [5, 8, 9]],
    ]
)
"""... and xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz in a cube."""


def largest(values: FloatArray, count: int) -> IntArray:
    """Rows of the ``count`` largest of (N,) values, in order; of equal ones the first come first.

    >>> largest(np.array([1.0, 3.0, 2.0, 3.0]), 3)
    array([1, 3, 2])
    """
    rows = np.arange(len(values))
    if count < len(values):
        rows = np.flatnonzero(values >= np.partition(values, len(values) - count)[-count])
    return rows[np.argsort(-values[rows], kind="stable")[:count]]


def as_floats(points_m: npt.ArrayLike) -> FloatArray:
    """(N, 3) points in one piece, float32 if they came so, else float64; no copy of what is so.

    The compiled loops take no other kinds, and are compiled once more for every other layout.

    >>> as_floats([[1, 2, 3]])
    array([[1., 2., 3.]])
    """
    array = np.asarray(points_m)
    return np.ascontiguousarray(array, np.float32 if array.dtype == np.float32 else np.float64)


@compiled
def bounds(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The (3,) smallest and largest coordinates of (N, 3) points, N >= 1, none of them NaN.

    >>> bounds(np.array([[1, 5, 0], [3, 2, 0]]))
    (array([1., 2., 0.]), array([3., 5., 0.]))
    """
    low_m, high_m = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points_m)):
        for axis in range(3):
            low_m[axis] = min(low_m[axis], points_m[i, axis])
            high_m[axis] = max(high_m[axis], points_m[i, axis])
    return low_m, high_m


@compiled
def farthest_m(points_m: FloatArray, middle_m: FloatArray) -> float:
    """The distance of the farthest of (N, 3) points from a (3,) place."""
    farthest_m2 = 0.0
    for i in range(len(points_m)):
        x, y, z = (
            points_m[i, 0] - middle_m[0],
            points_m[i, 1] - middle_m[1],
            points_m[i, 2] - middle_m[2],
        )
        square_m2 = x * x + y * y + z * z
        if square_m2 > farthest_m2:  # hardly ever, and nobody waits for the last one's maximum
            farthest_m2 = square_m2
    return np.sqrt(farthest_m2)


def central_moments(points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums over (N, 3) points, in one pass.

    Returns:
        (3,) their mean, and about it the (3, 3) sums of products of two coordinates and the
        (3, 3, 3) sums of products of three.
    """
    # Sums about a place among the points keep their digits.
    near_m = points_m[:: len(points_m) // _SAMPLE + 1].mean(axis=0, dtype=np.float64)
    sums = _sums_of_products(points_m, near_m)
    first, second = sums[:3], sums[3:9][_PAIRS]
    cubes = sums[9:][_TRIPLES]
    count = len(points_m)
    shift_m = first / count
    mixed = np.multiply.outer(shift_m, second)
    cubes -= mixed + mixed.transpose(1, 0, 2) + mixed.transpose(2, 1, 0)
    cubes += 2 * count * np.einsum("i,j,k->ijk", shift_m, shift_m, shift_m)
    return near_m + shift_m, second - count * np.outer(shift_m, shift_m), cubes


@compiled
def _sums_of_products(points_m: FloatArray, about_m: FloatArray) -> FloatArray:
    """(19,) sums of x, y, z; xx, xy, xz, yy, yz, zz; xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz,
    zzz of the points' coordinates about a place."""
    total = np.zeros(19)
    for start in range(0, len(points_m), _BLOCK):
        sums = np.zeros(19)
        for i in range(start, min(start + _BLOCK, len(points_m))):
            x = points_m[i, 0] - about_m[0]
            y = points_m[i, 1] - about_m[1]
            z = points_m[i, 2] - about_m[2]
            xx, xy, xz, yy, yz, zz = x * x, x * y, x * z, y * y, y * z, z * z
            sums[0] += x
            sums[1] += y
            sums[2] += z
            sums[3] += xx
            sums[4] += xy
            sums[5] += xz
            sums[6] += yy
            sums[7] += yz
            sums[8] += zz
            sums[9] += xx * x
            sums[10] += xx * y
            sums[11] += xx * z
            sums[12] += yy * x
            sums[13] += xy * z
            sums[14] += zz * x
            sums[15] += yy * y
            sums[16] += yy * z
            sums[17] += zz * y
            sums[18] += zz * z
        total += sums
    return total


def principal_frame(points_m: FloatArray) -> FloatArray:
    """The (4, 4) pose ``T_points_principal`` of a frame that (N, 3) points carry with them.

    Its origin is their mean, its axes are their principal directions, each towards the side where
    they reach farther (positive skewness). What is computed in it does not depend on the frame in
    which the points are given, nor on how far from that frame's origin they lie.

    >>> L = np.array([[0.0, 0, 0], [4, 0, 0], [0, 1, 0], [0, 0, 0.1]])
    >>> moved = L + [500_000.0, 0, 0]
    >>> np.allclose(principal_frame(moved)[:3, 3] - principal_frame(L)[:3, 3], [500_000, 0, 0])
    True
    """
    centre_m, second, third = central_moments(points_m)
    axes = np.linalg.eigh(second)[1][:, ::-1]
    skewness = np.einsum("ijk,ia,ja,ka->a", third, axes, axes, axes)
    axes = axes * np.where(skewness < 0, -1.0, 1.0)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])  # right-handed, whatever the third skewness says
    return make_transform(axes, centre_m)
