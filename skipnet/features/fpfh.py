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
_AT_ONCE = 256
"""Pairs whose angles are worked out together."""
_ARCTANGENT = (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.0117212)
"""Of odd powers in 0 to 1, right to 2e-6 ..."""
_TOO_NEAR = 1e-4
"""... so what comes this near to the border of two bins, in bins, is asked exactly."""
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
    columns = np.concatenate([there_m, turned], axis=1).T.copy()
    pairs, squared_m2 = _near_pairs(columns, starts, after, radius_m)
    own = np.zeros((len(points_m), 3 * BINS), dtype=np.float32)
    room = np.empty((10, _AT_ONCE)), np.empty((3, _AT_ONCE), dtype=np.int32)
    _count_angles(columns, pairs, squared_m2, *room, own)
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


def _near_pairs(
    columns: FloatArray, starts: IntArray, after: IntArray, radius_m: float
) -> tuple[IntArray, FloatArray]:
    """(P, 2) int32 rows of points within the radius of each other, each two once, and (P,) their
    squared distances; coincident points are no neighbours."""
    room_m2 = np.empty(np.diff(starts).max())
    none = np.empty((0, 2), np.int32), np.empty(0)
    count = _list_pairs(columns, starts, after, radius_m, room_m2, *none)
    pairs, squared_m2 = np.empty((count, 2), np.int32), np.empty(count)
    _list_pairs(columns, starts, after, radius_m, room_m2, pairs, squared_m2)
    return pairs, squared_m2


@compiled
def _list_pairs(
    columns: FloatArray,
    starts: IntArray,
    after: IntArray,
    radius_m: float,
    room_m2: FloatArray,
    pairs: IntArray,
    squared_m2: FloatArray,
) -> int:
    """Write the pairs if there is room; how many there are. Points are (3 or more, V) columns, and
    one's distances to all of a block are worked out together, into the room."""
    most_m2, count = radius_m * radius_m, 0
    for block in range(len(after)):
        for other in range(-1, 13):
            there = block if other < 0 else after[block, other]
            if there < 0:
                continue
            for i in range(starts[block], starts[block + 1]):
                first, end = i + 1 if other < 0 else starts[there], starts[there + 1]
                xs, ys, zs = columns[0, first:end], columns[1, first:end], columns[2, first:end]
                x_m, y_m, z_m = columns[0, i], columns[1, i], columns[2, i]
                near = 0
                for k in range(len(xs)):
                    x, y, z = xs[k] - x_m, ys[k] - y_m, zs[k] - z_m
                    room_m2[k] = x * x + y * y + z * z
                    near += (room_m2[k] > 0) & (room_m2[k] <= most_m2)
                if near > 0 and len(pairs) > 0:
                    last = count
                    for k in range(len(xs)):
                        if 0 < room_m2[k] <= most_m2:
                            pairs[last, 0], pairs[last, 1] = i, first + k
                            squared_m2[last] = room_m2[k]
                            last += 1
                count += near
    return count


@compiled
def _count_angles(
    columns: FloatArray,
    pairs: IntArray,
    squared_m2: FloatArray,
    room: FloatArray,
    bins: IntArray,
    seen: FloatArray,
) -> None:
    """Simplified histograms, into (V, 33) zeros: how a point's normal and its neighbours' are
    turned, each angle's bins in hundredths of the neighbours. Points and normals are (6, V)."""
    for start in range(0, len(pairs), bins.shape[1]):
        some = pairs[start : start + bins.shape[1]]
        for k in range(len(some)):
            i, j = some[k]
            for axis in range(3):
                room[axis, k] = columns[axis, j] - columns[axis, i]
                room[3 + axis, k] = columns[3 + axis, i]
                room[6 + axis, k] = columns[3 + axis, j]
        _find_bins(squared_m2[start : start + len(some)], room, bins)
        for k in range(len(some)):
            if abs(room[9, k] - np.rint(room[9, k])) < _TOO_NEAR:
                exact = (math.atan2(room[0, k], room[1, k]) + math.pi) / (2 * math.pi) * BINS
                bins[0, k] = min(max(int(exact), 0), BINS - 1)
            for point in some[k]:
                for angle in range(3):
                    seen[point, BINS * angle + bins[angle, k]] += 1
    for i in range(len(seen)):
        count = np.float32(0)
        for k in range(BINS):
            count += seen[i, k]
        for k in range(3 * BINS):
            seen[i, k] *= 100 / count if count > 0 else 0


@compiled
def _find_bins(squared_m2: FloatArray, room: FloatArray, bins: IntArray) -> None:
    """The bins of the three angles between oriented points (Darboux frame of the first), of as many
    pairs as there are squared distances; those of the first angle roughly.

    Args:
        squared_m2: (K,).
        room: (10, K or more) from one point to the other, and both normals; afterwards lines 0 and
            1 are sine and cosine of the first angle and line 9 is its place among the bins.
        bins: (3, K or more).
    """
    xs, ys, zs = room[0], room[1], room[2]
    for k in range(len(squared_m2)):
        distance_m = math.sqrt(squared_m2[k])
        x, y, z = xs[k] / distance_m, ys[k] / distance_m, zs[k] / distance_m
        to_i = room[3, k] * x + room[4, k] * y + room[5, k] * z
        to_j = room[6, k] * x + room[7, k] * y + room[8, k] * z
        # The one whose normal is nearer to the line comes first.
        swap = abs(to_i) < abs(to_j)
        along = -to_j if swap else to_i
        x, y, z = (-x if swap else x), (-y if swap else y), (-z if swap else z)
        u_x, n_x = (room[6, k], room[3, k]) if swap else (room[3, k], room[6, k])
        u_y, n_y = (room[7, k], room[4, k]) if swap else (room[4, k], room[7, k])
        u_z, n_z = (room[8, k], room[5, k]) if swap else (room[5, k], room[8, k])
        v_x, v_y, v_z = y * u_z - z * u_y, z * u_x - x * u_z, x * u_y - y * u_x
        length = math.sqrt(v_x * v_x + v_y * v_y + v_z * v_z)
        is_flat = length == 0
        length = 1.0 if is_flat else length
        v_x, v_y, v_z = v_x / length, v_y / length, v_z / length
        w_x, w_y, w_z = u_y * v_z - u_z * v_y, u_z * v_x - u_x * v_z, u_x * v_y - u_y * v_x
        sine, cosine = w_x * n_x + w_y * n_y + w_z * n_z, u_x * n_x + u_y * n_y + u_z * n_z
        across = 0.0 if is_flat else v_x * n_x + v_y * n_y + v_z * n_z
        along = 0.0 if is_flat else along
        place = BINS / 2 if is_flat else (_angle(sine, cosine) + math.pi) * (BINS / (2 * math.pi))
        room[0, k], room[1, k], room[9, k] = sine, cosine, place
        bins[0, k] = int(min(max(place, 0.0), BINS - 1.0))
        bins[1, k] = int(min(max((across + 1) / 2 * BINS, 0.0), BINS - 1.0))
        bins[2, k] = int(min(max((along + 1) / 2 * BINS, 0.0), BINS - 1.0))


@inlined
def _angle(sine: float, cosine: float) -> float:
    """As the arctangent of both, right to 2e-6."""
    s, c = abs(sine), abs(cosine)
    t = min(s, c) / max(max(s, c), 1e-300)
    a, b, d, e, f, g = _ARCTANGENT
    q = t * t
    angle = t * (a + q * (b + q * (d + q * (e + q * (f + q * g)))))
    angle = math.pi / 2 - angle if s > c else angle
    angle = math.pi - angle if cosine < 0 else angle
    return -angle if sine < 0 else angle


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
