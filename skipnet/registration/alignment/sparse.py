"""Fine alignment of sparse scans, whose scan lines lie further apart than voxels: GICP.

A voxel that holds one scan line has no normal of its own, so ``refinement`` finds no hold there.
Generalized ICP (Segal et al., RSS 2009) takes each point's surface from its nearest neighbours,
however far they are, and weighs two surfaces by how well they agree. small_gicp does it well; what
is checked here is that its answer is still the pose it was asked about.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skipnet.registration.alignment.refinement import Refinement
from skipnet.types import FloatArray

if TYPE_CHECKING:
    from small_gicp import KdTree, PointCloud, RegistrationResult

REACHES_VOXELS = (4.0, 2.0, 1.0)
"""Farthest correspondence, from the first alignment to the last."""
MAX_ITERATIONS = 12
"""At each reach; right poses need 5 or so, and wrong ones would go on for long."""
CORRELATED = 2.5
"""Times that residuals tell less than their number: neighbouring points share the surfaces that are
taken from them. Chosen on 36 simulated pairs of 16 lines, with what a thin plane's heap holds."""
MAX_SHIFT_VOXELS = 3.0
"""A pose that moves further has run away."""


def refine_sparse(
    before: Refinement,
    source: tuple[PointCloud, KdTree],
    target: tuple[PointCloud, KdTree],
    voxel_size_m: float,
) -> Refinement:
    """Refine candidate poses by GICP; those that run away or find nothing stay as they were.

    Args:
        before: the poses to start from, right to about two voxels.
        source: of ``thin``.
        target: likewise.
        voxel_size_m: edge of a voxel.
    """
    T, information = before.T_target_source.copy(), before.information.copy()
    matched, centre_m = before.matched.copy(), before.centre_m.copy()
    spread_m, points_m = before.spread_m.copy(), np.asarray(source[0].points())[:, :3]
    centre_source_m = points_m.mean(axis=0)
    for row, start in enumerate(before.T_target_source):
        found = _align(start, source, target, voxel_size_m)
        shift_m = (found.T_target_source - start)[:3] @ np.append(centre_source_m, 1)
        ran_away = np.linalg.norm(shift_m) > MAX_SHIFT_VOXELS * voxel_size_m
        if found.num_inliers == 0 or ran_away:
            continue
        T[row], matched[row] = found.T_target_source, found.num_inliers
        centre_m[row] = (T[row] @ np.append(centre_source_m, 1))[:3]
        spread_m[row] = np.sqrt(points_m.var(axis=0).sum())
        # Mean squared Mahalanobis distance: the scale that the covariances leave open.
        scale = CORRELATED * max(2 * found.error / found.num_inliers, 1e-12)
        information[row] = _in_target_axes(found.H, T[row], centre_source_m) / scale
    return Refinement(T, information, matched, centre_m, spread_m)


def _align(
    T_target_source: FloatArray,
    source: tuple[PointCloud, KdTree],
    target: tuple[PointCloud, KdTree],
    voxel_size_m: float,
) -> RegistrationResult:
    """One pose by GICP, with ever closer correspondences."""
    from small_gicp import align

    for reach_voxels in REACHES_VOXELS:
        found = align(
            target[0],
            source[0],
            target[1],
            T_target_source,
            max_correspondence_distance=reach_voxels * voxel_size_m,
            max_iterations=MAX_ITERATIONS,
            translation_epsilon=1e-4 * voxel_size_m,
            rotation_epsilon=1e-5,
        )
        T_target_source = found.T_target_source
    return found


def _in_target_axes(H: FloatArray, T_target_source: FloatArray, centre_m: FloatArray) -> FloatArray:
    """Normal matrix of a small motion behind the pose as one of a motion in the target's axes.

    Args:
        H: (6, 6) of (rotation, translation) about the source's origin, source axes.
        T_target_source: (4, 4) the pose.
        centre_m: (3,) in the source's frame; the point that the rotation is to leave in place.
    """
    R = T_target_source[:3, :3]
    skew = np.cross(np.eye(3), centre_m)
    # Turning about the centre by w moves the source's origin by  centre x w  in source axes.
    change = np.zeros((6, 6))
    change[:3, :3] = R.T
    change[3:, 3:] = R.T
    change[3:, :3] = skew @ R.T
    return change.T @ H @ change
