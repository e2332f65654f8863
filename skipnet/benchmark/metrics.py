"""Errors of one pose against the truth, and what they come to over many pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import pose_error
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
    """Both errors lie under the pair's thresholds."""

    @property
    def mean_error_m(self) -> float:
        """Mean of the three axis errors, as in the last column of the paper's Table 2."""
        return float(np.mean(self.axis_errors_m))


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
    )


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
