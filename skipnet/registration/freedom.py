"""Along what and about what a pose moves freely, because nothing that both scans show holds it."""

from __future__ import annotations

import numpy as np

from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.sliding import (
    MIN_DETERMINED,
    holds,
    holds_against,
    is_weak,
    moves_freely,
)
from skipnet.types import FloatArray

MIN_THICKNESS_VOXELS = 0.5
"""A scan whose voxels scatter by less about their plane is that plane."""
MIN_SPARSE_HOLD = 6.0
"""Voxels that must face a direction in sparse scans: their normals err, and fewer hold nothing."""


def free_directions(judge: Judge, best: Refinement, is_sparse: bool) -> FloatArray:
    """(F, 3) directions along which one pose can slide, in the target's frame.

    Noise may roughen a scan that shows nothing but one plane; it holds nothing all the same.
    """
    turns = best.T_target_source[0, :3, :3], np.eye(3)
    for scan, turn in zip((judge.source, judge.target), turns, strict=True):
        square_m2, axes = np.linalg.eigh(np.cov(scan.points_m.T.astype(np.float64)))
        if np.sqrt(square_m2[0]) < MIN_THICKNESS_VOXELS * judge.voxel_size_m:
            in_plane: FloatArray = (turn @ axes[:, 1:]).T
            return in_plane
    T, centre_m = best.T_target_source[0], best.centre_m[0]
    share, directions = holds(best.information[0], best.matched[0])
    free = [
        direction
        for part, direction in zip(share, directions, strict=True)
        if is_weak(part, best.matched[0])
        and (
            (is_sparse and part * best.matched[0] < MIN_SPARSE_HOLD)
            or moves_freely(np.append(np.zeros(3), direction), T, centre_m, judge)
        )
    ]
    return np.array(free).reshape(-1, 3)


def free_turns(judge: Judge, best: Refinement) -> FloatArray:
    """(G, 3) axes about which one pose can turn."""
    T, centre_m = best.T_target_source[0], best.centre_m[0]
    share, motions = holds_against(best.information[0], best.matched[0], best.spread_m[0])
    weak = motions[(share < MIN_DETERMINED) & motions[:, :3].any(axis=1)]
    turns = [
        motion[:3] / np.linalg.norm(motion[:3])
        for motion in weak
        if moves_freely(motion, T, centre_m, judge)
    ]
    return np.array(turns).reshape(-1, 3)
