"""Hypotheses: candidate poses, all of one type, and those that correspondences propose.

A generator takes what two scans show and returns a stack of ``T_target_source`` with weights; it
never judges. What one proposes is judged together with what the others do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import make_transform
from skipnet.types import FloatArray


@dataclass(frozen=True)
class Hypotheses:
    """Candidate poses."""

    T_target_source: FloatArray
    """(C, 4, 4) float64."""
    weights: FloatArray
    """(C,) how much speaks for each, comparable within one generator only."""

    def __len__(self) -> int:
        return len(self.weights)

    def best(self, count: int) -> Hypotheses:
        """The ``count`` heaviest."""
        keep = np.argsort(-self.weights, kind="stable")[:count]
        return Hypotheses(self.T_target_source[keep], self.weights[keep])


NO_HYPOTHESES = Hypotheses(np.zeros((0, 4, 4)), np.zeros(0))


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


def fit_transforms(source_m: FloatArray, target_m: FloatArray, weights: FloatArray) -> FloatArray:
    """(S, 4, 4) least-squares motions of S weighted sets of (S, K, 3) correspondences (Kabsch)."""
    share = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float64)[..., None]
    centre_s, centre_t = (source_m * share).sum(axis=1), (target_m * share).sum(axis=1)
    moved_s, moved_t = source_m - centre_s[:, None], target_m - centre_t[:, None]
    rotation = best_rotations(moved_t.transpose(0, 2, 1) @ (share * moved_s))
    return make_transform(rotation, centre_t - (rotation @ centre_s[..., None])[..., 0])


def _distances(points_m: FloatArray) -> FloatArray:
    points = (points_m - points_m.mean(axis=0)).astype(np.float32)
    squared = (points**2).sum(axis=1)
    gram = points @ points.T
    return np.sqrt(np.maximum(squared[:, None] + squared - 2 * gram, 0))


def concatenate(stacks: list[Hypotheses]) -> Hypotheses:
    """All candidates of several generators, in order."""
    if not stacks:
        return NO_HYPOTHESES
    return Hypotheses(
        np.concatenate([stack.T_target_source for stack in stacks]),
        np.concatenate([stack.weights for stack in stacks]),
    )


def best_rotations(correlation: FloatArray) -> FloatArray:
    """(R, 3, 3) rotations R that maximise sum(w a . R b), of correlations sum(w a b^T) (Kabsch)."""
    u, _, vt = np.linalg.svd(correlation)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def bisector_frames(first: FloatArray, second: FloatArray) -> FloatArray:
    """(P, 3, 3) right-handed frames of two directions each, in columns: bisector, across, normal.

    Neither direction is preferred: an error of the angle between them is shared.
    """
    third = np.cross(first, second)
    third /= np.linalg.norm(third, axis=1, keepdims=True)
    middle = first + second
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    return np.stack([middle, np.cross(third, middle), third], axis=-1)
