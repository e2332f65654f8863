"""Rigid motions and their conventions: ``T_a_b`` maps frame b into frame a, points are rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skipnet.types import FloatArray

_CHUNK = 1 << 14
"""Points handled at a time: enough to outweigh the calls, few enough for the cache, and for BLAS
to keep to one thread: two on so small a product wait for each other longer than they compute."""


def make_transform(rotation: FloatArray, translation_m: FloatArray) -> FloatArray:
    """Stack a rotation and a translation into homogeneous form.

    Args:
        rotation: (..., 3, 3) rotation matrices.
        translation_m: (..., 3) translations.

    Returns:
        (..., 4, 4) float64 transforms.
    """
    rotation = np.asarray(rotation, dtype=np.float64)
    transform = np.zeros((*rotation.shape[:-2], 4, 4))
    transform[..., :3, :3] = rotation
    transform[..., :3, 3] = translation_m
    transform[..., 3, 3] = 1.0
    return transform


def transform_points(T_a_b: FloatArray, points_b_m: FloatArray) -> FloatArray:
    """Map (..., N, 3) points of frame b into frame a by (..., 4, 4) ``T_a_b``.

    >>> transform_points(make_transform(np.eye(3), np.array([1.0, 0, 0])), np.zeros((1, 3)))
    array([[1., 0., 0.]])
    """
    if points_b_m.ndim == T_a_b.ndim == 2 and len(points_b_m) > _CHUNK:
        return np.concatenate([xyz_m.T for xyz_m in columns(points_b_m, T_a_b)])
    rotation = T_a_b[..., :3, :3]
    return points_b_m @ np.swapaxes(rotation, -1, -2) + T_a_b[..., None, :3, 3]


def columns(
    points_b_m: FloatArray, T_a_b: FloatArray | None = None, chunk: int = _CHUNK
) -> Iterator[FloatArray]:
    """Walk through (N, 3) points, chunk after chunk, without a copy of them all.

    Args:
        points_b_m: points of any real type.
        T_a_b: (4, 4) motion to apply on the way; None for none.
        chunk: points at a time.

    Yields:
        (3, n) float64 coordinates, each axis contiguous: several times faster to compute with.
    """
    for start in range(0, len(points_b_m), chunk):
        rows_m = points_b_m[start : start + chunk]
        xyz_m = np.empty((3, len(rows_m)))
        for first in range(0, len(rows_m), _CHUNK):
            piece_m = xyz_m[:, first : first + _CHUNK]
            piece_m[:] = rows_m[first : first + _CHUNK].T
            if T_a_b is not None:
                piece_m[:] = T_a_b[:3, :3] @ piece_m
                piece_m += T_a_b[:3, 3:]
        yield xyz_m


def bounds(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The (3,) smallest and largest coordinates of (N, 3) points, N >= 1; NaN if there is one.

    >>> bounds(np.array([[1, 5, 0], [3, 2, 0]]))
    (array([1., 2., 0.]), array([3., 5., 0.]))
    """
    ends = [(xyz_m.min(axis=1), xyz_m.max(axis=1)) for xyz_m in columns(points_m)]
    return np.min([low for low, _ in ends], axis=0), np.max([high for _, high in ends], axis=0)


def central_moments(points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums over (N, 3) points, in one pass.

    Returns:
        (3,) their mean, and about it the (3, 3) sums of products of two coordinates and the
        (3, 3, 3) sums of products of three.
    """
    near_m: FloatArray | float = 0.0  # sums about a place among the points keep their digits
    first, six, third = np.zeros(3), np.zeros(6), np.zeros((3, 6))
    i, j = np.triu_indices(3)
    for index, xyz_m in enumerate(columns(points_m)):
        near_m = near_m if index else xyz_m.mean(axis=1)
        xyz_m -= np.reshape(near_m, (3, 1))
        products = xyz_m[i]
        products *= xyz_m[j]
        first += xyz_m.sum(axis=1)
        six += products.sum(axis=1)
        third += [products @ axis_m for axis_m in xyz_m]  # BLAS is slow at one 3 x n x 6 product
    full = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    count, second, cubes = len(points_m), six[full], third[:, full]
    shift_m = first / count
    mixed = np.multiply.outer(shift_m, second)
    cubes -= mixed + mixed.transpose(1, 0, 2) + mixed.transpose(2, 1, 0)
    cubes += 2 * count * np.einsum("i,j,k->ijk", shift_m, shift_m, shift_m)
    return near_m + shift_m, second - count * np.outer(shift_m, shift_m), cubes


def invert(T_a_b: FloatArray) -> FloatArray:
    """The inverse ``T_b_a`` of (..., 4, 4) rigid transforms."""
    rotation_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    translation_m = -(rotation_b_a @ T_a_b[..., :3, 3:])[..., 0]
    return make_transform(rotation_b_a, translation_m)


def rotation_angle_rad(rotation: FloatArray) -> FloatArray:
    """Angle in [0, pi] of (..., 3, 3) rotations, accurate near 0 and near pi.

    Uses |R - I|_F = 2 sqrt(2) sin(angle / 2), which does not lose digits near zero as arccos does.
    """
    chord = np.linalg.norm(rotation - np.eye(3), axis=(-2, -1)) / (2 * np.sqrt(2))
    return 2 * np.arcsin(np.clip(chord, 0.0, 1.0))


def pose_error(T_estimated: FloatArray, T_true: FloatArray) -> tuple[float, float]:
    """Rotation error in radians (RRE) and translation error in metres (RTE) of one estimate."""
    rotation = T_estimated[:3, :3] @ T_true[:3, :3].T
    offset_m = T_estimated[:3, 3] - T_true[:3, 3]
    return float(rotation_angle_rad(rotation)), float(np.linalg.norm(offset_m))


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


def random_rotation(rng: np.random.Generator) -> FloatArray:
    """A (3, 3) rotation drawn uniformly from SO(3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.random(rng=rng).as_matrix()


def rotation_from_vector(vector_rad: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations about (..., 3) vectors by their lengths: Rodrigues' formula.

    SciPy has it too, in a package that takes longer to import than a registration to run.

    >>> rotation_from_vector(np.array([0, 0, np.pi / 2])).round(9) @ [1, 0, 0]
    array([0., 1., 0.])
    """
    vector_rad = np.asarray(vector_rad, dtype=np.float64)
    half_turns = np.linalg.norm(vector_rad, axis=-1)[..., None, None] / np.pi
    cross = np.cross(np.eye(3), vector_rad[..., None, :])
    bent = 0.5 * np.sinc(half_turns / 2) ** 2 * (cross @ cross)
    return np.eye(3) + np.sinc(half_turns) * cross + bent
