"""Which descriptors are near each other: mutual nearest ones, and a few more of each."""

from __future__ import annotations

import numpy as np

from skipnet.features.nearest import nearest_of_many
from skipnet.types import FloatArray, IntArray

_BLOCK = 128
"""Rows compared at a time: their distances to all others stay in the processor's cache."""
_MANY = 1 << 23
"""Distances between all and all that take longer than to look for near ones."""


def factors_of_squared_distances(
    source: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(V, D + 2) and (D + 2, W), whose product holds all squared distances of (V, D) and (W, D).

    |s - t|^2 = |s|^2 - 2 s.t + |t|^2 as one product of rows with two more columns.
    """
    ones_s, ones_t = (np.ones((len(rows), 1), np.float32) for rows in (source, target))
    squared_s, squared_t = ((rows**2).sum(axis=1, keepdims=True) for rows in (source, target))
    left = np.concatenate([-2 * source, squared_s, ones_s], axis=1)
    return left, np.concatenate([target, ones_t, squared_t], axis=1).T


def mutual_nearest(source: FloatArray, target: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of descriptors that are each other's nearest.

    Args:
        source: (V, D) descriptors.
        target: (W, D) descriptors.

    Returns:
        (K,) rows of the source, (K,) rows of the target, and (K,) their descriptors' distances.
    """
    if len(source) == 0 or len(target) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32)
    find = nearest_of_many if len(source) * len(target) > _MANY else _nearest_of_few
    rows_s, rows_t = find(source, target)
    return rows_s, rows_t, np.linalg.norm(source[rows_s] - target[rows_t], axis=1)


def _nearest_of_few(source: FloatArray, target: FloatArray) -> tuple[IntArray, IntArray]:
    """As ``nearest_of_many``, from all distances."""
    left, right = factors_of_squared_distances(source, target)
    forward = np.empty(len(source), dtype=np.int64)
    nearest_s = np.empty(len(source), dtype=np.float32)
    nearest_t = np.full(len(target), np.inf, dtype=np.float32)
    room, right = np.empty((_BLOCK, len(target)), dtype=np.float32), np.ascontiguousarray(right)
    for start in range(0, len(source), _BLOCK):
        block = slice(start, start + _BLOCK)
        squared = np.matmul(left[block], right, out=room[: len(source) - start])
        forward[block] = squared.argmin(axis=1)
        nearest_s[block] = np.take_along_axis(squared, forward[block, None], axis=1)[:, 0]
        np.minimum(nearest_t, squared.min(axis=0), out=nearest_t)
    # Both ways' minima come from one matrix: a pair is mutual when they are the same number.
    mutual = np.flatnonzero(nearest_s == nearest_t[forward])
    rows_t, first = np.unique(forward[mutual], return_index=True)  # of equal sources the first
    rows_s, order = np.sort(mutual[first]), np.argsort(mutual[first])
    return rows_s, rows_t[order]


def mutually_near(
    source: FloatArray, target: FloatArray, count: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of descriptors each of which is among the ``count`` nearest of the other.

    Where two scans share little, the right partner is often the second or third.

    Args:
        source: (V, D) descriptors.
        target: (W, D) descriptors.
        count: 1 gives the mutual nearest ones.

    Returns:
        As ``mutual_nearest``.
    """
    if len(source) == 0 or len(target) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32)
    left, right = factors_of_squared_distances(source, target)
    squared = left @ right
    rows_s, rows_t = among_nearest(squared, count)
    return rows_s, rows_t, np.linalg.norm(source[rows_s] - target[rows_t], axis=1)


def among_nearest(distances: FloatArray, count: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of a (V, W) table, none of them empty, that are among the ``count`` nearest
    of each other."""
    near = np.ones(distances.shape, dtype=bool)
    for axis, others in enumerate(distances.shape):
        last = min(count, others) - 1
        near &= distances <= np.partition(distances, last, axis=axis).take([last], axis=axis)
    rows, columns = np.nonzero(near)
    return rows, columns
