"""Rigid motions and their conventions: ``T_a_b`` maps frame b into frame a, points are rows."""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray, IntArray


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
    rotation = T_a_b[..., :3, :3]
    return points_b_m @ np.swapaxes(rotation, -1, -2) + T_a_b[..., None, :3, 3]


def invert(T_a_b: FloatArray) -> FloatArray:
    """The inverse ``T_b_a`` of (..., 4, 4) rigid transforms."""
    rotation_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    translation_m = -(rotation_b_a @ T_a_b[..., :3, 3:])[..., 0]
    return make_transform(rotation_b_a, translation_m)


def straightened(T_a_b: FloatArray) -> FloatArray:
    """A (4, 4) transform that is rigid but for rounding, made rigid.

    In a long chain of products and inverses what rounding adds doubles with every inverse. One step
    of Newton's iteration for the nearest rotation leaves the square of the error.
    """
    rotation = T_a_b[:3, :3]
    nearest = 1.5 * rotation - 0.5 * rotation @ rotation.T @ rotation
    return make_transform(nearest, T_a_b[:3, 3])


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
    cross = np.zeros((*vector_rad.shape[:-1], 3, 3))
    x, y, z = (vector_rad[..., axis] for axis in range(3))
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    cross -= np.swapaxes(cross, -1, -2)
    bent = 0.5 * np.sinc(half_turns / 2) ** 2 * (cross @ cross)
    return np.eye(3) + np.sinc(half_turns) * cross + bent


def nearest(from_m: FloatArray, to_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Of each of (N, 3) points the nearest of (M, 3) others: (N,) distances and rows.

    By small_gicp, which is as fast as SciPy and need not be imported for a fifth of a second.
    Points in an order in which the next is near the last take half the time.
    """
    from small_gicp import KdTree

    tree = KdTree(np.asarray(to_m, np.float64))
    rows, squares_m2 = tree.batch_nearest_neighbor_search(np.asarray(from_m, np.float64))
    return np.sqrt(np.asarray(squares_m2)), np.asarray(rows, np.int64)
