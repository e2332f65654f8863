"""Errors of poses and correspondences against the truth, and rates over many pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, pose_error, transform_points
from skipnet.skipmap.cells import cells_of, pack
from skipnet.types import FloatArray, Pair


@dataclass(frozen=True)
class PoseScore:
    """How far one estimated pose is from the truth; every error is inf where there is no pose."""

    rotation_error_rad: float
    """Angle of the rotation that is left (RRE), in [0, pi]."""
    translation_error_m: float
    """Length of the difference of the two translations (RTE)."""
    axis_errors_m: tuple[float, float, float]
    """Mean displacement of the source's points along the target's X, Y and Z."""
    success: bool
    """Both errors lie under the pair's own thresholds."""
    rmse_m: float | None = None
    """RMSE through gt.info; None where the pair has none."""

    @property
    def mean_error_m(self) -> float:
        """Mean of the three axis errors, as in the last column of the paper's Table 2."""
        return float(np.mean(self.axis_errors_m))


INLIER_SHARE = 0.05
"""Feature-matching recall counts pairs with more inliers than this (Deng et al., CVPR 2018)."""

MISSING_POSE = PoseScore(np.inf, np.inf, (np.inf, np.inf, np.inf), success=False)
"""The score of a method that gave no pose: a failure that stays in the denominator."""


def axis_errors_m(
    T_estimated: FloatArray, T_true: FloatArray, source_m: FloatArray
) -> tuple[float, float, float]:
    """Mean over the source's points p of |T_estimated p - T_true p|, along each axis of the target.

    This is the project's reading of the errors "along X, Y, Z" in the paper's Table 2, which does
    not define them. Unlike a difference of translations it does not depend on where the origin is.

    Args:
        T_estimated: (4, 4) ``T_target_source`` of a method.
        T_true: (4, 4) true ``T_target_source``.
        source_m: (N, 3) points in the source's frame, N >= 1.

    >>> turned = np.diag([-1.0, -1.0, 1.0, 1.0])    # half a turn about Z
    >>> axis_errors_m(turned, np.eye(4), np.array([[1.0, 0.0, 5.0], [2.0, 0.5, 5.0]]))
    (3.0, 0.5, 0.0)
    """
    if len(source_m) == 0:
        raise ValueError(
            "axis errors are means over the source's points: got none, need at least one"
        )
    difference = np.asarray(T_estimated, dtype=np.float64) - np.asarray(T_true, dtype=np.float64)
    displacement_m = (
        np.asarray(source_m, dtype=np.float64) @ difference[:3, :3].T + difference[:3, 3]
    )
    x_m, y_m, z_m = np.abs(displacement_m).mean(axis=0)
    return float(x_m), float(y_m), float(z_m)


def score_pose(T_estimated: FloatArray | None, pair: Pair) -> PoseScore:
    """Score an estimate of ``pair.T_target_source``; None, NaN or inf is a failure."""
    if T_estimated is None or not np.isfinite(T_estimated).all():
        return MISSING_POSE
    rotation_error_rad, translation_error_m = pose_error(T_estimated, pair.T_target_source)
    return PoseScore(
        rotation_error_rad=rotation_error_rad,
        translation_error_m=translation_error_m,
        axis_errors_m=axis_errors_m(T_estimated, pair.T_target_source, pair.source_m),
        success=bool(
            rotation_error_rad < pair.success_rotation_rad
            and translation_error_m < pair.success_translation_m
        ),
        rmse_m=None if pair.information is None else rmse_m(T_estimated, pair),
    )


def rmse_m(T_estimated: FloatArray, pair: Pair) -> float:
    """RMSE of the pair's true correspondences under an estimate, through its gt.info.

    Choi et al., "Robust reconstruction of indoor scenes", CVPR 2015, as evaluated by 3DMatch: a
    quadratic approximation from the translation and the quaternion of inv(truth) @ estimate.

    Raises:
        ValueError: the pair has no gt.info.
    """
    from scipy.spatial.transform import Rotation

    if pair.information is None:
        raise ValueError(f"{pair.name} has no gt.info: expected a 6x6 matrix")
    left = invert(pair.T_target_source) @ T_estimated
    quaternion = Rotation.from_matrix(left[:3, :3]).as_quat(canonical=True)  # x, y, z, w >= 0
    error = np.concatenate([left[:3, 3], quaternion[:3]])
    squared = error @ pair.information @ error / pair.information[0, 0]
    return float(np.sqrt(max(squared, 0.0)))


def inlier_ratio(
    source_m: FloatArray, target_m: FloatArray, T_true: FloatArray, max_distance_m: float
) -> float:
    """Share of correspondences whose points meet under the true pose; 0 for none at all.

    Args:
        source_m: (K, 3) points of the source.
        target_m: (K, 3) the points of the target that a method holds for the same.
        T_true: (4, 4) true ``T_target_source``.
        max_distance_m: below it they meet; 0.1 m in 3DMatch.
    """
    if len(source_m) == 0:
        return 0.0
    distance_m = np.linalg.norm(transform_points(T_true, source_m) - target_m, axis=1)
    return float((distance_m < max_distance_m).mean())


def measured_overlap(pair: Pair, voxel_size_m: float) -> float:
    """Share of the source's occupied voxels that lie within a voxel of the target, by the truth."""
    from scipy.spatial import cKDTree

    source_m = transform_points(pair.T_target_source, _one_per_cell(pair.source_m, voxel_size_m))
    tree = cKDTree(_one_per_cell(pair.target_m, voxel_size_m / 2))
    distance_m, _ = tree.query(source_m, distance_upper_bound=voxel_size_m)
    return float(np.isfinite(distance_m).mean())


def _one_per_cell(points_m: FloatArray, size_m: float) -> FloatArray:
    cells = pack(cells_of(points_m, size_m, np.median(points_m, axis=0)))
    return points_m[np.unique(cells, return_index=True)[1]]


def success_rate(successes: list[bool]) -> float:
    """Share of pairs that came out right; a pair without a pose is in the list, as False."""
    if not successes:
        raise ValueError("a success rate needs at least one pair: got an empty list")
    return float(np.mean(successes))


def wilson_interval(successes: int, pairs: int) -> tuple[float, float]:
    """95 % interval of a success rate (Wilson 1927): 40 of 40 does not prove 100 %.

    >>> low, high = wilson_interval(40, 40)
    >>> round(low, 3), round(high, 3)
    (0.912, 1.0)
    """
    if not 0 <= successes <= pairs or pairs == 0:
        raise ValueError(
            f"expected 0 <= successes <= pairs and pairs > 0, got {successes} of {pairs}"
        )
    z = 1.959964
    share = successes / pairs
    middle = (share + z**2 / (2 * pairs)) / (1 + z**2 / pairs)
    spread = z / (1 + z**2 / pairs) * np.sqrt(share * (1 - share) / pairs + (z / (2 * pairs)) ** 2)
    return float(max(0.0, middle - spread)), float(min(1.0, middle + spread))
