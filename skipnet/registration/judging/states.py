"""What each voxel of one scan is to the other under a pose: matching, beside, or in free space."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.registration.judging.score import Strictness
from skipnet.scans.evidence import Evidence
from skipnet.scans.range_image import RangeImage
from skipnet.types import BoolArray, FloatArray, IntArray

MAX_ACROSS_COSINE = 0.7
"""Surfaces whose normals are farther apart cross each other."""
MAX_SIDES = 0.5
"""Surfaces that are so surely the two sides of something may lie beside each other: a thin wall."""


def facing(T_b_a: FloatArray, points_m: FloatArray, normals: FloatArray) -> FloatArray:
    """(C - 1, S) squared cosine between the motions of (S, 3) points from the first of (C, 4, 4)
    poses to each other one and their normals: what each tells of the motion."""
    turned = normals @ T_b_a[0, :3, :3].T
    told = np.empty((len(T_b_a) - 1, len(points_m)))
    _tell(T_b_a[1:, :3] - T_b_a[0, :3], points_m, turned, told)
    return told


def states(
    T_b_a: FloatArray, a: Evidence, b: Evidence, samples: int, strictness: Strictness
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """(C, S) how far each of a's voxels matches b, 0 to 1, which lie beside it, and which in b's
    free space."""
    match, beside = matches(T_b_a, a, b, samples, strictness)
    free = np.zeros_like(beside)
    if b.range_image is not None:
        free_m = strictness.free_voxels * b.voxel_size_m
        free = b.range_image.in_front(T_b_a, a.points_m, match < 0.5, strictness.free_share, free_m)
        if strictness.min_facing_cosine > 0:
            free = _without_grazing(free, T_b_a, a, b.range_image, strictness.min_facing_cosine)
    return match, beside, free


def matches(
    T_b_a: FloatArray, a: Evidence, b: Evidence, samples: int, strictness: Strictness
) -> tuple[FloatArray, BoolArray]:
    """(C, S) how far each of a's voxels matches b, 0 to 1, and which lie beside it."""
    return matches_there(T_b_a, a, b, b.near.find_moved(T_b_a, a.points_m, samples), strictness)


def matches_there(
    T_b_a: FloatArray, a: Evidence, b: Evidence, rows: IntArray, strictness: Strictness
) -> tuple[FloatArray, BoolArray]:
    """As ``matches``, where the (C, S) rows of b are known on which a's voxels come to lie."""
    return _match(
        T_b_a[:, :3].astype(np.float32),
        (a.points_m, a.normals, a.sides, a.clear),
        rows,
        (b.surfaces, b.clear_there),
        strictness.min_normal_cosine,
        strictness.max_distance_voxels * b.voxel_size_m,
        strictness.max_beside_voxels * b.voxel_size_m,
    )


def _without_grazing(
    free: BoolArray, T_b_a: FloatArray, a: Evidence, image: RangeImage, min_facing_cosine: float
) -> BoolArray:
    """(C, S) which of a's voxels that lie in free space are turned to the sensor that saw it."""
    from_origin_m = image.viewpoint_m - T_b_a[:, :3, 3]
    sensor_m = np.einsum("cji,cj->ci", T_b_a[:, :3, :3], from_origin_m)
    turned = np.empty_like(free)
    _turn_to(sensor_m, a.points_m, a.normals, free, min_facing_cosine, turned)
    return turned


@compiled
def _turn_to(
    sensor_m: FloatArray,
    points_m: FloatArray,
    normals: FloatArray,
    asked: BoolArray,
    min_cosine: float,
    turned: BoolArray,
) -> None:
    """See ``_without_grazing``: which of the (C, S) voxels asked about face (C, 3) sensors."""
    for c in range(len(sensor_m)):
        at_x_m, at_y_m, at_z_m = sensor_m[c, 0], sensor_m[c, 1], sensor_m[c, 2]
        for s in range(asked.shape[1]):
            turned[c, s] = False
            if asked[c, s]:
                x_m, y_m = points_m[s, 0] - at_x_m, points_m[s, 1] - at_y_m
                z_m = points_m[s, 2] - at_z_m
                across_m = x_m * normals[s, 0] + y_m * normals[s, 1] + z_m * normals[s, 2]
                range_m = np.sqrt(x_m * x_m + y_m * y_m + z_m * z_m)
                turned[c, s] = abs(across_m) >= min_cosine * range_m


@compiled
def _tell(change: FloatArray, points_m: FloatArray, normals: FloatArray, told: FloatArray) -> None:
    """See ``facing``: (K, 3, 4) by how much the motions differ, and normals turned by the first."""
    for c in range(len(change)):
        xx, xy, xz, x0 = change[c, 0]
        yx, yy, yz, y0 = change[c, 1]
        zx, zy, zz, z0 = change[c, 2]
        for s in range(len(points_m)):
            x_m, y_m, z_m = points_m[s, 0], points_m[s, 1], points_m[s, 2]
            x = xx * x_m + xy * y_m + xz * z_m + x0
            y = yx * x_m + yy * y_m + yz * z_m + y0
            z = zx * x_m + zy * y_m + zz * z_m + z0
            along_m = x * normals[s, 0] + y * normals[s, 1] + z * normals[s, 2]
            told[c, s] = along_m * along_m / max(x * x + y * y + z * z, 1e-24)


@compiled
def _match(
    T_b_a: FloatArray,
    voxels_a: tuple[FloatArray, FloatArray, FloatArray, BoolArray],
    row: IntArray,
    voxels_b: tuple[FloatArray, BoolArray],
    min_normal_cosine: float,
    max_distance_m: float,
    max_beside_m: float,
) -> tuple[FloatArray, BoolArray]:
    """(C, S) how far a's voxels lie on the surface of b's voxels in (C, S) ``row``, 0 to 1, and
    which lie beside it or cross it, where both are clear enough to tell."""
    points_a_m, normals_a, sides_a, clear_a = voxels_a
    surfaces_b, clear_b = voxels_b
    match = np.zeros(row.shape, dtype=np.float32)
    beside = np.zeros(row.shape, dtype=np.bool_)
    for c in range(len(T_b_a)):
        T = T_b_a[c]
        for s in range(row.shape[1]):
            there = row[c, s]
            if there >= 0:
                n_x, n_y, n_z = surfaces_b[there, 0], surfaces_b[there, 1], surfaces_b[there, 2]
                # b's normal in the frame of a: one turn serves for the point and its normal.
                a_x = T[0, 0] * n_x + T[1, 0] * n_y + T[2, 0] * n_z
                a_y = T[0, 1] * n_x + T[1, 1] * n_y + T[2, 1] * n_z
                a_z = T[0, 2] * n_x + T[1, 2] * n_y + T[2, 2] * n_z
                cosine = a_x * normals_a[s, 0] + a_y * normals_a[s, 1] + a_z * normals_a[s, 2]
                offset_m = surfaces_b[there, 3] - T[0, 3] * n_x - T[1, 3] * n_y - T[2, 3] * n_z
                distance_m = a_x * points_a_m[s, 0] + a_y * points_a_m[s, 1]
                distance_m = abs(distance_m + a_z * points_a_m[s, 2] - offset_m)
                along = abs(cosine) > min_normal_cosine
                # Opposite normals are two sides of something, as far as the sides are known.
                apart = sides_a[s] * surfaces_b[there, 4] if cosine < 0 else 0.0
                if along and distance_m <= max_distance_m:
                    match[c, s] = 1 - apart
                if clear_a[s] and clear_b[there]:
                    parallel = along and max_distance_m < distance_m < max_beside_m
                    parallel = parallel and apart < MAX_SIDES
                    across = abs(cosine) < MAX_ACROSS_COSINE and distance_m < max_distance_m
                    beside[c, s] = parallel or across
    return match, beside
