"""Which poses are about the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.projects.witness import Witness
from skipnet.types import BoolArray, FloatArray, IntArray

SAME_VOXELS = 3.0
"""Two poses put a scan, or a group, in about the same place when its centre is less than this apart
..."""
SAME_TURN_RAD = 0.05
"""... and it is turned by less."""


def same_place(
    witness: Witness, scan: int | Sequence[int], T_one: FloatArray, T_other: FloatArray
) -> BoolArray:
    """Whether poses put scans in about the same places.

    Args:
        witness: knows the scans.
        scan: one for all poses, or one for each.
        T_one: (..., 4, 4) poses.
        T_other: likewise.
    """
    centre_m = np.asarray(witness.centres_m)[scan]
    change = T_one - T_other
    shift_m = np.einsum("...ij,...j->...i", change[..., :3, :3], centre_m) + change[..., :3, 3]
    alike = np.sum(T_one[..., :3, :3] * T_other[..., :3, :3], axis=(-2, -1))
    near = np.sum(shift_m**2, axis=-1) <= (SAME_VOXELS * witness.voxel_size_m) ** 2
    same: BoolArray = near & (alike >= 1 + 2 * np.cos(SAME_TURN_RAD))
    return same


def leaders(
    T: FloatArray, centre_m: FloatArray, max_shift_m: float, max_angle_rad: float = SAME_TURN_RAD
) -> IntArray:
    """(K,) for each of (K, 4, 4) poses the first one that is about the same.

    Args:
        T: poses, the most trusted first.
        centre_m: (3,) the point whose shift tells how far two poses are apart.
        max_shift_m: poses that put it closer together than this are about the same ...
        max_angle_rad: ... if they are also turned by less than this.
    """
    rotations = T[:, :3, :3].reshape(-1, 9)
    moved_m = T[:, :3, :3] @ centre_m + T[:, :3, 3]
    # By a matrix product: differences of all with all are the slowest part of growing groups.
    moved_m = moved_m - moved_m.mean(axis=0)
    square_m2 = np.sum(moved_m**2, axis=1)
    apart_m2 = square_m2[:, None] + square_m2 - 2 * moved_m @ moved_m.T
    same = rotations @ rotations.T >= 1 + 2 * np.cos(max_angle_rad)
    same &= apart_m2 <= max_shift_m**2
    leader = np.full(len(T), -1)
    for row in range(len(T)):
        if leader[row] < 0:
            leader[same[row] & (leader < 0)] = row
    return leader
