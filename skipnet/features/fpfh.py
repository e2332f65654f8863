"""Fast point feature histograms of voxels: how the normals about each one are turned."""

from __future__ import annotations

import math

import numpy as np

from skipnet.compiled import compiled, inlined
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

FPFH_RADIUS_VOXELS = 5.0
BINS = 11
"""Of each of the three angles."""
_HALF_OF_NEIGHBOURS = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)][14:]
)
"""Of the 26 blocks around one those that come after it: each two meet once."""


def fpfh(skipmap: SkipMap) -> FloatArray:
    """Fast point feature histograms on the Skip-map's centroids (Rusu et al., ICRA 2009).

    As PCL and Open3D compute them, from all neighbours within the radius.

    Args:
        skipmap: normals of one scan must agree in side; without a viewpoint those that look to the
            origin are taken.

    Returns:
        (V, 33) float32, one row per voxel.
    """
    if skipmap.viewpoint_m is None:
        skipmap = skipmap.seen_from(np.zeros(3))
    radius_m = FPFH_RADIUS_VOXELS * skipmap.voxel_size_m
    return point_feature_histograms(skipmap.centroids_m, skipmap.normals, radius_m)


def point_feature_histograms(
    points_m: FloatArray, normals: FloatArray, radius_m: float
) -> FloatArray:
    """(V, 33) float32 FPFH of (V, 3) points with (V, 3) unit normals, from all within a radius."""
    if len(points_m) == 0:
        return np.zeros((0, 3 * BINS), dtype=np.float32)
    order, starts, after = _blocks(points_m, radius_m)
    there_m, turned = points_m[order].astype(np.float64), normals[order].astype(np.float64)
    pairs, squared_m2 = _near_pairs(there_m, starts, after, radius_m)
    own = np.zeros((len(points_m), 3 * BINS), dtype=np.float32)
    _count_angles(there_m, turned, pairs, squared_m2, own)
    summed, result = np.zeros_like(own), np.empty_like(own)
    _add_neighbours(own, pairs, squared_m2, radius_m, summed)
    result[order] = summed
    return result


def _blocks(points_m: FloatArray, edge_m: float) -> tuple[IntArray, IntArray, IntArray]:
    """(V,) the points' order by blocks of space, (B + 1,) where each block begins, and (B, 13) the
    blocks that touch it and come later, -1 for none."""
    cells = np.floor((points_m - points_m.min(axis=0)) / edge_m).astype(np.int64) + 1
    extent = cells.max(axis=0) + 2
    keys = np.ravel_multi_index(cells.T, tuple(extent))
    order = np.argsort(keys, kind="stable")
    blocks, starts = np.unique(keys[order], return_index=True)
    steps = _HALF_OF_NEIGHBOURS @ np.array([extent[1] * extent[2], extent[2], 1])
    wanted = blocks[:, None] + steps
    row = np.minimum(np.searchsorted(blocks, wanted), len(blocks) - 1)
    after = np.where(blocks[row] == wanted, row, -1)
    return order, np.append(starts, len(points_m)), after


@inlined
def _bin(value: float) -> int:
    """Of a value in 0 to 1."""
    return min(max(int(value * 11), 0), 10)


def _near_pairs(
    points_m: FloatArray, starts: IntArray, after: IntArray, radius_m: float
) -> tuple[IntArray, FloatArray]:
    """(P, 2) int32 rows of points within the radius of each other, each two once, and (P,) their
    squared distances; coincident points are no neighbours."""
    none = np.empty((0, 2), np.int32), np.empty(0)
    count = _list_pairs(points_m, starts, after, radius_m, *none)
    pairs, squared_m2 = np.empty((count, 2), np.int32), np.empty(count)
    _list_pairs(points_m, starts, after, radius_m, pairs, squared_m2)
    return pairs, squared_m2


@compiled
def _list_pairs(
    points_m: FloatArray,
    starts: IntArray,
    after: IntArray,
    radius_m: float,
    pairs: IntArray,
    squared_m2: FloatArray,
) -> int:
    """Write the pairs for which there is room; how many there are."""
    count = 0
    for block in range(len(after)):
        for other in range(-1, 13):
            there = block if other < 0 else after[block, other]
            if there < 0:
                continue
            for i in range(starts[block], starts[block + 1]):
                for j in range(i + 1 if other < 0 else starts[there], starts[there + 1]):
                    x = points_m[j, 0] - points_m[i, 0]
                    y = points_m[j, 1] - points_m[i, 1]
                    z = points_m[j, 2] - points_m[i, 2]
                    square_m2 = x * x + y * y + z * z
                    if 0 < square_m2 <= radius_m * radius_m:
                        if count < len(pairs):
                            pairs[count, 0], pairs[count, 1] = i, j
                            squared_m2[count] = square_m2
                        count += 1
    return count


@compiled
def _count_angles(
    points_m: FloatArray,
    normals: FloatArray,
    pairs: IntArray,
    squared_m2: FloatArray,
    seen: FloatArray,
) -> None:
    """Simplified histograms, into (V, 33) zeros: how a point's normal and its neighbours' are
    turned, each angle's bins in hundredths of the neighbours."""
    for pair in range(len(pairs)):
        i, j = pairs[pair, 0], pairs[pair, 1]
        first, second, third = _angles(points_m, normals, i, j, math.sqrt(squared_m2[pair]))
        for point in (i, j):
            seen[point, first] += 1
            seen[point, 11 + second] += 1
            seen[point, 22 + third] += 1
    for i in range(len(seen)):
        count = np.float32(0)
        for k in range(11):
            count += seen[i, k]
        for k in range(33):
            seen[i, k] *= 100 / count if count > 0 else 0


@inlined
def _angles(
    points_m: FloatArray, normals: FloatArray, i: int, j: int, distance_m: float
) -> tuple[int, int, int]:
    """The bins of the three angles between two oriented points (Darboux frame of the first)."""
    x = (points_m[j, 0] - points_m[i, 0]) / distance_m
    y = (points_m[j, 1] - points_m[i, 1]) / distance_m
    z = (points_m[j, 2] - points_m[i, 2]) / distance_m
    to_i = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z
    to_j = normals[j, 0] * x + normals[j, 1] * y + normals[j, 2] * z
    a, b, along = i, j, to_i
    if abs(to_i) < abs(to_j):  # the one whose normal is nearer to the line comes first
        a, b, along, x, y, z = j, i, -to_j, -x, -y, -z
    u_x, u_y, u_z = normals[a, 0], normals[a, 1], normals[a, 2]
    v_x, v_y, v_z = y * u_z - z * u_y, z * u_x - x * u_z, x * u_y - y * u_x
    length = math.sqrt(v_x * v_x + v_y * v_y + v_z * v_z)
    if length == 0:
        return 5, 5, 5
    v_x, v_y, v_z = v_x / length, v_y / length, v_z / length
    w_x, w_y, w_z = u_y * v_z - u_z * v_y, u_z * v_x - u_x * v_z, u_x * v_y - u_y * v_x
    n_x, n_y, n_z = normals[b, 0], normals[b, 1], normals[b, 2]
    turned = math.atan2(w_x * n_x + w_y * n_y + w_z * n_z, u_x * n_x + u_y * n_y + u_z * n_z)
    across = v_x * n_x + v_y * n_y + v_z * n_z
    first = _bin((turned + math.pi) / (2 * math.pi))
    return first, _bin((across + 1) / 2), _bin((along + 1) / 2)


@compiled
def _add_neighbours(
    own: FloatArray,
    pairs: IntArray,
    squared_m2: FloatArray,
    radius_m: float,
    summed: FloatArray,
) -> None:
    """The points' own histograms and those of their neighbours, the nearer the more, into (V, 33)
    zeros."""
    for pair in range(len(pairs)):
        i, j = pairs[pair, 0], pairs[pair, 1]
        weight = np.float32(radius_m * radius_m / squared_m2[pair])
        for k in range(33):
            summed[i, k] += weight * own[j, k]
            summed[j, k] += weight * own[i, k]
    for i in range(len(summed)):
        for angle in range(3):
            whole = np.float32(0)
            for k in range(11 * angle, 11 * angle + 11):
                whole += summed[i, k]
            for k in range(11 * angle, 11 * angle + 11):
                summed[i, k] = own[i, k] + (100 * summed[i, k] / whole if whole > 0 else 0)
