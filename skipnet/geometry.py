"""Rigid motions and their conventions: ``T_a_b`` maps frame b into frame a, points are rows."""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray


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
    centre_m = points_m.mean(axis=0, dtype=np.float64)
    centred_m = points_m - centre_m
    axes = np.linalg.eigh(centred_m.T @ centred_m)[1][:, ::-1]
    along_m = centred_m @ axes
    skewness = (along_m * along_m * along_m).sum(axis=0)  # several times faster than ** 3
    axes = axes * np.where(skewness < 0, -1.0, 1.0)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])  # right-handed, whatever the third skewness says
    return make_transform(axes, centre_m)


def random_rotation(rng: np.random.Generator) -> FloatArray:
    """A (3, 3) rotation drawn uniformly from SO(3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.random(rng=rng).as_matrix()


def rotation_from_vector(vector_rad: FloatArray) -> FloatArray:
    """(3, 3) rotation about ``vector_rad`` by its length (the exponential map)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector_rad).as_matrix()
