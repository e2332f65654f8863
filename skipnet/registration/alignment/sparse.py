"""Fine alignment of sparse scans, whose scan lines lie further apart than voxels: GICP.

A voxel that holds one scan line has no normal of its own, so ``refinement`` finds no hold there.
Generalized ICP (Segal et al., RSS 2009) takes each point's surface from its nearest neighbours,
however far they are, and weighs two surfaces by how well they agree. Candidates are aligned
together, by a sample of the points; the one that is best by small_gicp, with all of them. What is
checked here is that an answer is still the pose that was asked about.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skipnet.registration.alignment.distributions import match_distributions
from skipnet.registration.alignment.refinement import Refinement, apply, gauss_newton_step
from skipnet.scans.sparse import Thinned
from skipnet.types import FloatArray

REACHES_VOXELS = (4.0, 2.0, 1.0)
"""Farthest correspondence, from the first alignment to the last."""
MAX_STEPS = 5
"""Of each candidate, at each reach."""
SAMPLES = 1000
"""Points of the source that candidates are aligned with."""
MAX_ITERATIONS = 12
"""Of the best one's last alignment."""
CORRELATED = 2.5
"""Times that residuals tell less than their number: neighbouring points share the surfaces that are
taken from them. Chosen on 36 simulated pairs of 16 lines, with what a thin plane's heap holds."""
MAX_SHIFT_VOXELS = 3.0
"""A pose that moves further has run away."""


def refine_sparse(
    before: Refinement,
    source: Thinned,
    target: Thinned,
    voxel_size_m: float,
    are_worth_more: Callable[[FloatArray], bool] = lambda T_target_source: True,
) -> Refinement:
    """Refine candidate poses by GICP; those that run away or find nothing stay as they were.

    Args:
        before: the poses to start from, right to about two voxels.
        source: of ``thin``.
        target: likewise.
        voxel_size_m: edge of a voxel.
        are_worth_more: asked of the (C, 4, 4) poses after the farthest correspondences, which move
            them most: whether nearer ones are worth the time.
    """
    T = before.T_target_source
    if len(T) == 0:
        return before
    share = max(1, len(source.points_m) // SAMPLES)
    rows = np.arange(0, len(source.points_m), share)
    for reach_voxels in REACHES_VOXELS:
        for _ in range(MAX_STEPS):
            reach_m = reach_voxels * voxel_size_m
            matches, squared = match_distributions(T, source, rows, target, reach_m)
            T, moved_m = gauss_newton_step(T, matches)
            if moved_m < 1e-3 * voxel_size_m:
                break
        if reach_voxels == REACHES_VOXELS[0] and not are_worth_more(T):
            break
    # The mean squared Mahalanobis distance is the scale that the covariances leave open; what a
    # sample holds, all points hold so many times as firmly.
    firmness = share / (CORRELATED * np.maximum(squared, 1e-12))
    information = matches.information * firmness[:, None, None]
    found = Refinement(T, information, share * matches.matched, matches.centre_m, matches.spread_m)
    return _unless_lost(before, found, source, voxel_size_m)


def finish_sparse(
    before: Refinement, source: Thinned, target: Thinned, voxel_size_m: float
) -> Refinement:
    """Align one refined pose by all points; arguments as of ``refine_sparse``."""
    from small_gicp import align

    found = align(
        target.cloud,
        source.cloud,
        target.tree,
        before.T_target_source[0],
        max_correspondence_distance=REACHES_VOXELS[-1] * voxel_size_m,
        max_iterations=MAX_ITERATIONS,
        translation_epsilon=1e-4 * voxel_size_m,
        rotation_epsilon=1e-5,
    )
    T, centre_source_m = found.T_target_source, source.points_m.mean(axis=0)
    scale = CORRELATED * max(2 * found.error / max(found.num_inliers, 1), 1e-12)
    information = _in_target_axes(found.H, T, centre_source_m) / scale
    after = Refinement(
        T[None],
        information[None],
        np.array([found.num_inliers]),
        (T[:3, :3] @ centre_source_m + T[:3, 3])[None],
        np.sqrt(source.points_m.var(axis=0).sum())[None],
    )
    return _unless_lost(before, after, source, voxel_size_m)


def _unless_lost(
    before: Refinement, after: Refinement, source: Thinned, voxel_size_m: float
) -> Refinement:
    """After alignment, or as before it where a pose ran away or found nothing."""
    centre_m = np.broadcast_to(source.points_m.mean(axis=0), (len(after.matched), 3))
    moved_m = apply(after.T_target_source, centre_m) - apply(before.T_target_source, centre_m)
    shift_m = np.linalg.norm(moved_m, axis=1)
    good = (after.matched > 0) & (shift_m <= MAX_SHIFT_VOXELS * voxel_size_m)
    return after.where(good, before)


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
