"""Hypotheses: candidate poses, all of one type, and those that correspondences propose.

A generator takes what two scans show and returns a stack of ``T_target_source`` with weights; it
never judges. What one proposes is judged together with what the others do.
"""

from __future__ import annotations

import numpy as np

from skipnet.registration.hypotheses.fitting import fit_transforms
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses
from skipnet.types import FloatArray


def from_correspondences(
    source_m: FloatArray,
    target_m: FloatArray,
    weights: FloatArray,
    max_distance_m: float,
    seeds: int = 120,
    support: int = 20,
) -> Hypotheses:
    """Poses from sets of correspondences that agree with each other: second-order compatibility.

    Two correspondences are compatible when they keep their distance; they support each other by
    the number of third ones compatible with both (SC2-PCR, Chen et al., CVPR 2022). Each seed's
    strongest supporters give one pose by weighted least squares.

    Args:
        source_m: (K, 3) points of the source ...
        target_m: (K, 3) ... and the target points they may correspond to.
        weights: (K,) prior trust in each correspondence.
        max_distance_m: largest change of distance between compatible correspondences.
        seeds: correspondences to start from.
        support: correspondences that enter each pose, the seed included.

    Returns:
        At most ``seeds`` candidates; none from fewer than three correspondences.
    """
    if len(source_m) < 3:
        return NO_HYPOTHESES
    change_m = np.abs(_distances(source_m) - _distances(target_m))
    compatible = (change_m < max_distance_m).astype(np.float32)
    np.fill_diagonal(compatible, 0)
    second = compatible * (compatible @ compatible)
    chosen = np.argsort(-(second @ weights.astype(np.float32)), kind="stable")[:seeds]
    np.fill_diagonal(second, np.inf)
    members = np.argsort(-second[chosen], axis=1, kind="stable")[:, :support]
    strength = np.minimum(np.take_along_axis(second[chosen], members, axis=1), len(source_m))
    usable = (strength > 0).sum(axis=1) >= 3
    chosen, members, strength = chosen[usable], members[usable], strength[usable]
    T_target_source = fit_transforms(source_m[members], target_m[members], strength)
    return Hypotheses(T_target_source, strength.sum(axis=1))


def _distances(points_m: FloatArray) -> FloatArray:
    points = (points_m - points_m.mean(axis=0)).astype(np.float32)
    squared = (points**2).sum(axis=1)
    gram = points @ points.T
    return np.sqrt(np.maximum(squared[:, None] + squared - 2 * gram, 0))
