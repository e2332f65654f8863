"""Checking what comes in, and dropping the points that no surface explains."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from skipnet.clouds.statistics import as_floats, central_moments
from skipnet.compiled import compiled
from skipnet.types import BoolArray, FloatArray, IntArray

# Points on a line leave the rotation about it free; their spread across it is rounding alone.
_RELATIVE_SPREAD_OF_A_LINE = 1e-6
_SORTING_CELLS_PER_AXIS = 128
_SAMPLE = 1000
_LARGEST_M = 1e30
"""Of a coordinate, in whatever unit: cubes of larger ones, added up, have no numbers."""


def validate(points: npt.ArrayLike, name: str) -> FloatArray:
    """Check that an array-like is a point cloud that can be registered.

    Args:
        points: (N, 3) numbers, metres.
        name: what to call it in the errors, such as "source".

    Returns:
        (N, 3) points in one piece, float32 if they came so, else float64; no copy of what is so.

    Raises:
        ValueError: wrong shape or kind, NaN or infinity, fewer points than a plane needs,
            or all on a line.
    """
    array = np.asarray(points)
    if array.dtype.kind not in "iuf" or array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(
            f"{name}: got {array.dtype} of shape {array.shape}: expected numbers of shape (N, 3)"
        )
    array = as_floats(array)
    if not _all_usable(array):
        finite = np.isfinite(array).all(axis=1)
        if finite.all():
            raise ValueError(
                f"{name}: got coordinates up to {np.abs(array).max():.3g}: expected metres, below "
                f"{_LARGEST_M:g}"
            )
        raise ValueError(
            f"{name}: {np.count_nonzero(~finite)} of {len(array)} points hold NaN or infinity: "
            f"drop them, for example by points[np.isfinite(points).all(axis=1)]"
        )
    if len(array) < 3:
        raise ValueError(f"{name}: got {len(array)} points: a plane needs 3, a scan has thousands")
    # What holds for some of the points holds for all; a look at every point is seldom needed.
    if not (_spans_surface(array[:: len(array) // _SAMPLE + 1]) or _spans_surface(array)):
        raise ValueError(
            f"{name}: all {len(array)} points lie on one line or in one place: expected a surface"
        )
    return array


@compiled
def _all_usable(array: FloatArray) -> bool:
    """Whether no coordinate is NaN, infinite, or so large that its cube cannot be computed with."""
    unusable = 0  # counted to the end, which is quicker than to decide at each
    for coordinate in array.ravel():
        unusable += not abs(coordinate) < _LARGEST_M
    return unusable == 0


def _spans_surface(points_m: FloatArray) -> bool:
    """Whether points spread in two directions by more than rounding."""
    spread_m2 = np.linalg.eigvalsh(central_moments(points_m)[1])
    return bool(spread_m2[1] > _RELATIVE_SPREAD_OF_A_LINE**2 * spread_m2[2])


def denoise(points_m: FloatArray, neighbours: int = 4, sigma: float = 1.0) -> BoolArray:
    """Which points to keep, by the rule of MATLAB's ``pcdenoise``.

    A point goes when the mean distance to its nearest neighbours exceeds the mean of that figure
    over all points by ``sigma`` of its standard deviations. The defaults are MATLAB's and the
    paper's.

    Args:
        points_m: (N, 3) points, more than ``neighbours``.
        neighbours: how many nearest neighbours are averaged, the point itself not among them.
        sigma: standard deviations above the mean; infinity keeps everything.

    Returns:
        (N,) bool, True for the points to keep.

    Raises:
        ValueError: too few points, or a ``neighbours`` or ``sigma`` below their range.
    """
    if neighbours < 1 or sigma < 0:
        raise ValueError(
            f"got neighbours={neighbours}, sigma={sigma}: expected at least 1 and at least 0"
        )
    if len(points_m) <= neighbours:
        raise ValueError(
            f"got {len(points_m)} points: {neighbours} neighbours need at least {neighbours + 1}"
        )
    distance_m = _mean_neighbour_distance_m(points_m, neighbours)
    return distance_m <= distance_m.mean() + sigma * distance_m.std(ddof=1)


def _mean_neighbour_distance_m(points_m: FloatArray, neighbours: int) -> FloatArray:
    from scipy.spatial import cKDTree

    # Queries in the order of space find the tree's nodes in the cache: a fifth of the time.
    order = _spatial_order(points_m)
    ordered_m = points_m[order]
    tree = cKDTree(ordered_m, balanced_tree=False, compact_nodes=False)
    distances_m, _ = tree.query(ordered_m, k=neighbours + 1, workers=-1)
    mean_m = np.empty(len(points_m))
    mean_m[order] = distances_m[:, 1:].mean(axis=1)  # column 0 is the point itself, at distance 0
    return mean_m


def _spatial_order(points_m: FloatArray) -> IntArray:
    """(N,) indices that sort points by the cells of a coarse grid."""
    low_m = points_m.min(axis=0)
    cell_m = (
        max(float(np.ptp(points_m, axis=0).max()), np.finfo(float).tiny) / _SORTING_CELLS_PER_AXIS
    )
    x, y, z = ((points_m - low_m) / cell_m).astype(np.int64).T
    stride = _SORTING_CELLS_PER_AXIS + 1
    return np.argsort((x * stride + y) * stride + z, kind="stable")
