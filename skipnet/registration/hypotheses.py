"""Hypotheses: candidate poses from planes, corners, edges and correspondences, all of one type.

A generator takes what two scans show and returns a stack of ``T_target_source`` with weights; it never
judges. What one proposes is judged together with what the others do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform
from skipnet.types import FloatArray, IntArray


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


def from_planes(
    source: Planes,
    target: Planes,
    voxel_size_m: float,
    max_rotations: int = 60,
    per_rotation: int = 80,
    max_angle_rad: float = 0.06,
) -> Hypotheses:
    """Rotations from pairs of planes that meet at equal angles, translations from parallel planes' offsets.

    Args:
        source: planes of the source, normals towards its sensor (or with both signs).
        target: planes of the target, likewise.
        voxel_size_m: offsets that differ by less support the same translation.
        max_rotations: distinct rotations to keep.
        per_rotation: translations to keep for each.
        max_angle_rad: largest disagreement of angles between planes.
    """
    rotations = _plane_rotations(source, target, max_rotations, max_angle_rad)
    stacks = [
        _plane_translations(rotation, source, target, voxel_size_m, per_rotation, max_angle_rad)
        for rotation in rotations
    ]
    return concatenate([stack for stack in stacks if len(stack)])


def from_correspondences(
    source_m: FloatArray,
    target_m: FloatArray,
    weights: FloatArray,
    max_distance_m: float,
    seeds: int = 120,
    support: int = 20,
) -> Hypotheses:
    """Poses from sets of correspondences that agree with each other: second-order compatibility.

    Two correspondences are compatible when they keep their distance; they support each other by the
    number of third ones compatible with both (SC2-PCR, Chen et al., CVPR 2022). Each seed's strongest
    supporters give one pose by weighted least squares.

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
    """(S, 4, 4) least-squares rigid motions of S weighted sets of (S, K, 3) correspondences (Kabsch)."""
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


def _plane_rotations(source: Planes, target: Planes, max_rotations: int, max_angle_rad: float) -> FloatArray:
    """(R, 3, 3) distinct rotations that align many plane normals, best first."""
    i, j = _oblique_pairs(source.normals, ordered=False)
    k, m = _oblique_pairs(target.normals, ordered=True)
    angle_s = np.arccos(np.clip((source.normals[i] * source.normals[j]).sum(1), -1, 1))
    angle_t = np.arccos(np.clip((target.normals[k] * target.normals[m]).sum(1), -1, 1))
    p, q = np.nonzero(np.abs(angle_s[:, None] - angle_t) < max_angle_rad)
    if len(p) == 0:
        return np.zeros((0, 3, 3))
    weight = np.minimum(source.weights[i[p]], target.weights[k[q]]) * np.minimum(
        source.weights[j[p]], target.weights[m[q]]
    )
    best = np.argsort(-weight, kind="stable")[:3000]
    p, q = p[best], q[best]
    rotations = _frames(target.normals[k[q]], target.normals[m[q]]) @ _frames(
        source.normals[i[p]], source.normals[j[p]]
    ).transpose(0, 2, 1)
    support = _shared_area(rotations, source, target, 1.5 * max_angle_rad).sum(axis=(1, 2))
    rotations = _distinct_rotations(rotations, support, max_rotations, 1.5 * max_angle_rad)
    shared = _shared_area(rotations, source, target, 1.5 * max_angle_rad)
    return best_rotations(np.einsum("rst,ti,sj->rij", shared, target.normals, source.normals))


def _oblique_pairs(normals: FloatArray, ordered: bool) -> tuple[IntArray, IntArray]:
    """Index pairs of normals at least 20 degrees from parallel."""
    sine = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    pairs = sine > np.sin(np.deg2rad(20))
    return np.nonzero(pairs if ordered else np.triu(pairs))


def _frames(first: FloatArray, second: FloatArray) -> FloatArray:
    """(P, 3, 3) right-handed frames in columns: symmetric in both directions, so neither is preferred."""
    third = np.cross(first, second)
    third /= np.linalg.norm(third, axis=1, keepdims=True)
    middle = first + second
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    return np.stack([middle, np.cross(third, middle), third], axis=-1)


def _shared_area(rotations: FloatArray, source: Planes, target: Planes, max_angle_rad: float) -> FloatArray:
    """(R, S, T) area that each source plane shares with the target plane nearest to it in direction."""
    cosine = np.einsum("rij,sj,ti->rst", rotations, source.normals, target.normals, optimize=True)
    shared = np.where(cosine > np.cos(max_angle_rad), np.minimum(source.weights[:, None], target.weights), 0.0)
    return np.where(shared == shared.max(axis=2, keepdims=True), shared, 0.0)


def best_rotations(correlation: FloatArray) -> FloatArray:
    """(R, 3, 3) rotations nearest to correlation matrices sum(w a b^T): R maximises sum(w a . R b) (Kabsch)."""
    u, _, vt = np.linalg.svd(correlation)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def _distinct_rotations(
    rotations: FloatArray, support: FloatArray, max_rotations: int, min_angle_rad: float
) -> FloatArray:
    """Greedy choice by support; rotations within ``min_angle_rad`` of a better one are dropped."""
    min_trace = 1 + 2 * np.cos(min_angle_rad)
    left = np.argsort(-support, kind="stable")
    kept = []
    while len(left) and len(kept) < max_rotations:
        kept.append(left[0])
        trace = np.einsum("rij,ij->r", rotations[left], rotations[left[0]])
        left = left[trace < min_trace]
    return rotations[kept]


def _plane_translations(
    rotation: FloatArray,
    source: Planes,
    target: Planes,
    voxel_size_m: float,
    count: int,
    max_angle_rad: float,
) -> Hypotheses:
    """Translations on which offsets of parallel planes agree, voted along three axes."""
    cosine = target.normals @ (source.normals @ rotation.T).T
    t, s = np.nonzero(cosine > np.cos(1.5 * max_angle_rad))
    if len(t) == 0:
        return NO_HYPOTHESES
    moved_m = source.centroids_m[s] @ rotation.T
    shift_m = target.offsets_m[t] - (target.normals[t] * moved_m).sum(axis=1)
    weight = np.minimum(target.weights[t], source.weights[s])
    axes = _three_axes(target.normals[t], weight)
    if len(axes) < 3:
        return NO_HYPOTHESES
    votes = []
    for axis in axes:
        along = target.normals[t] @ axis
        parallel = np.abs(along) > np.cos(2 * max_angle_rad)
        signed_m = shift_m[parallel] * np.sign(along[parallel])
        votes.append(_vote(signed_m, weight[parallel], voxel_size_m))
    grids = np.meshgrid(*[offset for offset, _ in votes], indexing="ij")
    offsets_m = np.stack([grid.ravel() for grid in grids], axis=-1)
    total = sum(np.meshgrid(*[support for _, support in votes], indexing="ij")).ravel()
    best = np.argsort(-total, kind="stable")[:count]
    translations_m = np.linalg.solve(axes, offsets_m[best].T).T
    return Hypotheses(make_transform(np.broadcast_to(rotation, (len(best), 3, 3)), translations_m), total[best])


def _three_axes(normals: FloatArray, weights: FloatArray) -> FloatArray:
    """Up to three well-spread directions of much area: rows (A, 3), A < 3 when the planes leave one free."""
    axes: list[FloatArray] = []
    free = np.ones(len(normals))
    for _ in range(3):
        gain = weights * free
        best = int(gain.argmax())
        if free[best] < np.sin(np.deg2rad(20)):
            break
        axes.append(normals[best])
        basis = np.linalg.qr(np.array(axes).T)[0]
        free = np.linalg.norm(normals - normals @ basis @ basis.T, axis=1)
    return np.array(axes)


def _vote(
    offsets_m: FloatArray, weights: FloatArray, width_m: float, count: int = 10
) -> tuple[FloatArray, FloatArray]:
    """The ``count`` offsets with the most weight within ``width_m``, and that weight."""
    near = np.abs(offsets_m[:, None] - offsets_m) < width_m
    support = near @ weights
    mean_m = (near @ (weights * offsets_m)) / support
    peaks: list[int] = []
    for candidate in np.argsort(-support, kind="stable"):
        if all(abs(mean_m[candidate] - mean_m[peak]) > width_m for peak in peaks):
            peaks.append(int(candidate))
        if len(peaks) == count:
            break
    return mean_m[peaks], support[peaks]
