"""Hypotheses from the paper's classified features: corners of equal class, and pairs of edges."""

from __future__ import annotations

import numpy as np

from skipnet.features.keypoints import Corners, Lines
from skipnet.geometry import make_transform
from skipnet.registration.hypotheses.correspondences import from_correspondences
from skipnet.registration.hypotheses.fitting import bisector_frames
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses
from skipnet.registration.hypotheses.plane_rotations import oblique_pairs
from skipnet.types import FloatArray, IntArray


def from_corners(
    source: Corners,
    target: Corners,
    voxel_size_m: float,
    same_class: bool = True,
    max_correspondences: int = 1500,
) -> Hypotheses:
    """The paper's coarse match: corners of equal class are matched, R and t solved from sets.

    Every corner may correspond to every one of its class; sets that keep their distances survive.

    Args:
        source: corners of the source.
        target: corners of the target.
        voxel_size_m: how exactly corners are known.
        same_class: False lets corners of different classes correspond too.
        max_correspondences: the most trusted pairs are kept.
    """
    pairs = np.ones((len(source), len(target)), dtype=bool)
    if same_class:
        pairs = source.classes[:, None] == target.classes
    s, t = np.nonzero(pairs)
    trust = source.weights[s] * target.weights[t]
    best = np.argsort(-trust, kind="stable")[:max_correspondences]
    s, t = s[best], t[best]
    return from_correspondences(
        source.points_m[s], target.points_m[t], trust[best], voxel_size_m, seeds=300, support=8
    )


def from_edges(
    source: Lines,
    target: Lines,
    voxel_size_m: float,
    max_angle_rad: float = 0.06,
    count: int = 2000,
) -> Hypotheses:
    """Two edges that are not parallel fix a pose: pairs with equal angle and distance correspond.

    The frame of a pair sits on its common perpendicular; an edge has no sign, so each
    correspondence gives four poses.

    Args:
        source: edges of the source.
        target: edges of the target.
        voxel_size_m: largest difference of the distances between the edges of a pair.
        max_angle_rad: largest difference of the angles.
        count: the longest edges' poses are kept.
    """
    i, j = oblique_pairs(source.directions, ordered=False)
    k, m = oblique_pairs(target.directions, ordered=True)
    if len(i) == 0 or len(k) == 0:
        return NO_HYPOTHESES
    angle_s, gap_s = _angle_and_gap(source, i, j)
    angle_t, gap_t = _angle_and_gap(target, k, m)
    same = np.abs(angle_s[:, None] - angle_t) < max_angle_rad
    same &= np.abs(gap_s[:, None] - gap_t) < voxel_size_m
    p, q = np.nonzero(same)
    weight = np.minimum(source.weights[i[p]], target.weights[k[q]]) * np.minimum(
        source.weights[j[p]], target.weights[m[q]]
    )
    best = np.argsort(-weight, kind="stable")[: count // 4]
    p, q = p[best], q[best]
    centre_s, frame_s = _pair_frames(source, i[p], j[p], np.ones(2))
    poses = []
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        centre_t, frame_t = _pair_frames(target, k[q], m[q], np.array(signs))
        rotation = frame_t @ frame_s.transpose(0, 2, 1)
        poses.append(make_transform(rotation, centre_t - (rotation @ centre_s[..., None])[..., 0]))
    T_target_source = np.concatenate(poses)
    return Hypotheses(T_target_source, np.tile(np.sqrt(weight[best]), 4))


def _angle_and_gap(lines: Lines, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Angle between two lines in [0, pi / 2] and their distance in metres."""
    cosine = np.abs((lines.directions[i] * lines.directions[j]).sum(axis=1))
    normal = np.cross(lines.directions[i], lines.directions[j])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gap_m = np.abs(((lines.points_m[j] - lines.points_m[i]) * normal).sum(axis=1))
    return np.arccos(np.clip(cosine, 0, 1)), gap_m


def _pair_frames(
    lines: Lines, i: IntArray, j: IntArray, signs: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(P, 3) middles of the common perpendiculars, (P, 3, 3) frames of the directions."""
    first, second = lines.directions[i] * signs[0], lines.directions[j] * signs[1]
    between_m = lines.points_m[j] - lines.points_m[i]
    cosine = (first * second).sum(axis=1)
    along_first = (between_m * first).sum(axis=1)
    along_second = (between_m * second).sum(axis=1)
    sine2 = 1 - cosine**2
    foot_i = lines.points_m[i] + ((along_first - cosine * along_second) / sine2)[:, None] * first
    foot_j = lines.points_m[j] + ((cosine * along_first - along_second) / sine2)[:, None] * second
    return 0.5 * (foot_i + foot_j), bisector_frames(first, second)
