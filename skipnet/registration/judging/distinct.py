"""Which of many poses are others than all better ones, and not the same once more."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import BoolArray, FloatArray, IntArray


def distinct(
    T_target_source: FloatArray,
    centre_m: FloatArray,
    min_distance_m: float,
    min_angle_rad: float = 0.05,
) -> IntArray:
    """Rows of the poses that differ from every better one before them.

    Args:
        T_target_source: (C, 4, 4) candidates, best first.
        centre_m: (3,) centre of the source, which shows how far two poses are apart.
        min_distance_m: poses that move it apart by more are distinct ...
        min_angle_rad: ... and so are those turned by more.
    """
    poses = np.empty((len(T_target_source), 12))
    poses[:, :9] = T_target_source[:, :3, :3].reshape(-1, 9)
    poses[:, 9:] = T_target_source[:, :3, :3] @ centre_m + T_target_source[:, :3, 3]
    left, kept = np.ones(len(poses), dtype=bool), np.empty(len(poses), dtype=np.int64)
    near = 1 + 2 * np.cos(min_angle_rad), min_distance_m**2
    return kept[: _keep_distinct(poses.T.copy(), near, left, kept)]


@compiled
def _keep_distinct(
    poses: FloatArray, near: tuple[float, float], left: BoolArray, kept: IntArray
) -> int:
    """Write the rows of (12, C) rotations and places that differ from all better ones kept; how
    many there are. All of (C,) are left before."""
    (least_trace, most_m2), count = near, 0
    for row in range(len(left)):
        if not left[row]:
            continue
        kept[count] = row
        count += 1
        xx, xy, xz = poses[0, row], poses[1, row], poses[2, row]
        yx, yy, yz = poses[3, row], poses[4, row], poses[5, row]
        zx, zy, zz = poses[6, row], poses[7, row], poses[8, row]
        x_m, y_m, z_m = poses[9, row], poses[10, row], poses[11, row]
        for c in range(row + 1, len(left)):
            trace = xx * poses[0, c] + xy * poses[1, c] + xz * poses[2, c]
            trace += yx * poses[3, c] + yy * poses[4, c] + yz * poses[5, c]
            trace += zx * poses[6, c] + zy * poses[7, c] + zz * poses[8, c]
            x, y, z = poses[9, c] - x_m, poses[10, c] - y_m, poses[11, c] - z_m
            same = (trace >= least_trace) & (x * x + y * y + z * z <= most_m2)
            left[c] = left[c] & (not same)
    return count
