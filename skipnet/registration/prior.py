"""A pose that somebody believes in (GNSS, compass, a guess): one more hypothesis, never trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

import numpy as np
import numpy.typing as npt

from skipnet.checks import require
from skipnet.geometry import make_transform, pose_error, rotation_from_vector
from skipnet.types import FloatArray

_DRAWS = 96
"""Poses about a prior that are judged."""
_OWN_STD_VOXELS, _OWN_STD_DEG = 3.0, 3.0
"""How far a prior may be off if nobody says."""
_AGREES_STDS = 3.0


@dataclass(frozen=True)
class Prior:
    """Where the source may stand in the target's frame.

    The pose, and others about it as far off as it may be, are judged like those that the scans
    themselves propose. It has no say in the verdict: where the scans speak for another pose, that
    one comes out, and the reason names the difference.
    """

    T_target_source: npt.ArrayLike
    """(4, 4) maps the source into the target's frame, metres."""
    position_std_m: float | None = None
    """Standard deviation of its place; None takes three voxels."""
    rotation_std_deg: float | None = None
    """Standard deviation of its rotation about any axis; None takes three degrees."""

    def __post_init__(self) -> None:
        T = np.asarray(self.T_target_source)
        if T.shape != (4, 4) or T.dtype.kind not in "iuf" or not np.isfinite(T).all():
            raise ValueError(f"prior: got {T.dtype} {T.shape}: expected a finite pose (4, 4)")
        turn = T[:3, :3]
        is_rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
        if not is_rigid or not np.allclose(T[3], [0, 0, 0, 1]):
            raise ValueError("prior: is no rigid motion: expected a rotation and a translation")
        for name in ("position_std_m", "rotation_std_deg"):
            value = getattr(self, name)
            is_number = isinstance(value, Real) and 0 <= float(value) < math.inf
            require(value is None or is_number, name, value, "0 or more, or None")


@dataclass(frozen=True)
class PriorCheck:
    """How far the answer is from the prior."""

    off_m: float
    """Of the source's centre."""
    off_rad: float
    agrees: bool
    """By no more than the prior may be off."""

    def __str__(self) -> str:
        off = f"{self.off_m:.3g} m and {math.degrees(self.off_rad):.2g} deg"
        if self.agrees:
            return f"within what the prior allows, {off} from it"
        return f"not where the prior says, but {off} from it"


def as_prior(prior: Prior | npt.ArrayLike | None) -> Prior | None:
    """A Prior of a (4, 4) pose; None stays None.

    Raises:
        ValueError: it is no rigid motion.
    """
    return prior if prior is None or isinstance(prior, Prior) else Prior(prior)


def poses_about(prior: Prior, centre_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """(C, 4, 4) the prior and poses as far from it as it may be off, always the same.

    Args:
        prior: the pose.
        centre_m: (3,) of the source in its frame, about which it is turned.
        voxel_size_m: edge of a voxel.
    """
    position_m, rotation_rad = _deviations(prior, voxel_size_m)
    rng = np.random.default_rng(0)
    shifts_m = position_m * rng.normal(size=(_DRAWS, 3))
    turns_rad = rotation_rad * rng.normal(size=(_DRAWS, 3))
    shifts_m[0] = turns_rad[0] = 0
    T = np.asarray(prior.T_target_source, np.float64)
    middle_m = T[:3, :3] @ centre_m + T[:3, 3]
    moves = [
        make_transform(turn, middle_m - turn @ middle_m + shift_m)
        for turn, shift_m in zip(rotation_from_vector(turns_rad), shifts_m, strict=True)
    ]
    return np.array([move @ T for move in moves])


def compare(
    prior: Prior, T_target_source: FloatArray, centre_m: FloatArray, voxel_size_m: float
) -> PriorCheck:
    """How far a pose is from the prior."""
    T_prior = np.asarray(prior.T_target_source, np.float64)
    off_m = float(np.linalg.norm((T_target_source - T_prior)[:3] @ np.append(centre_m, 1)))
    off_rad = float(pose_error(T_target_source, T_prior)[0])
    position_m, rotation_rad = _deviations(prior, voxel_size_m)
    agrees = off_m <= _AGREES_STDS * math.sqrt(3) * position_m + voxel_size_m
    agrees &= off_rad <= _AGREES_STDS * math.sqrt(3) * rotation_rad + math.radians(1)
    return PriorCheck(off_m, off_rad, agrees)


def _deviations(prior: Prior, voxel_size_m: float) -> tuple[float, float]:
    position_m, rotation_deg = prior.position_std_m, prior.rotation_std_deg
    return (
        _OWN_STD_VOXELS * voxel_size_m if position_m is None else position_m,
        math.radians(_OWN_STD_DEG if rotation_deg is None else rotation_deg),
    )
