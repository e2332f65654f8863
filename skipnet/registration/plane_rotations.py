"""Rotations that lay the planes of one scan on those of another."""

from __future__ import annotations

import numpy as np

from skipnet.features.primitives import Planes
from skipnet.registration.hypotheses import best_rotations, bisector_frames
from skipnet.types import FloatArray, IntArray

_ROTATIONS_AT_ONCE = 128
"""So few that what is computed of them on the way stays in the processor's cache."""


def plane_rotations(
    source: Planes,
    target: Planes,
    max_rotations: int,
    max_angle_rad: float,
    min_share: float = 0.0,
) -> FloatArray:
    """(R, 3, 3) distinct rotations that align many plane normals, best first.

    Args:
        source: planes of the source.
        target: planes of the target.
        max_rotations: to keep.
        max_angle_rad: largest disagreement of angles between planes.
        min_share: drop those that align less than this share of the area that the best one does.
    """
    i, j = oblique_pairs(source.normals, ordered=False)
    k, m = oblique_pairs(target.normals, ordered=True)
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
    frames_t = bisector_frames(target.normals[k[q]], target.normals[m[q]])
    frames_s = bisector_frames(source.normals[i[p]], source.normals[j[p]])
    rotations: FloatArray = frames_t @ frames_s.transpose(0, 2, 1)
    starts = range(0, len(rotations), _ROTATIONS_AT_ONCE)
    chunks = (rotations[start : start + _ROTATIONS_AT_ONCE] for start in starts)
    support = np.concatenate(
        [_shared_area(chunk, source, target, 1.5 * max_angle_rad).sum((1, 2)) for chunk in chunks]
    )
    aligned = support >= min_share * support.max()
    rotations = _distinct_rotations(
        rotations[aligned], support[aligned], max_rotations, 1.5 * max_angle_rad
    )
    shared = _shared_area(rotations, source, target, 1.5 * max_angle_rad)
    return best_rotations(np.einsum("rst,ti,sj->rij", shared, target.normals, source.normals))


def oblique_pairs(normals: FloatArray, ordered: bool) -> tuple[IntArray, IntArray]:
    """Index pairs of normals at least 20 degrees from parallel."""
    sine = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    pairs = sine > np.sin(np.deg2rad(20))
    first, second = np.nonzero(pairs if ordered else np.triu(pairs))
    return first, second


def _shared_area(
    rotations: FloatArray, source: Planes, target: Planes, max_angle_rad: float
) -> FloatArray:
    """(R, S, T) area that each source plane shares with the target plane most parallel to it."""
    turned = (rotations @ source.normals.T).transpose(0, 2, 1).reshape(-1, 3)
    cosine = (turned @ target.normals.T).reshape(len(rotations), len(source), len(target))
    area = np.minimum(source.weights[:, None], target.weights)
    shared = np.multiply(cosine > np.cos(max_angle_rad), area)
    shared *= shared == shared.max(axis=2, keepdims=True)
    return shared


def _distinct_rotations(
    rotations: FloatArray, support: FloatArray, max_rotations: int, min_angle_rad: float
) -> FloatArray:
    """Greedy choice by support; rotations within ``min_angle_rad`` of a better one are dropped."""
    min_trace = 1 + 2 * np.cos(min_angle_rad)
    left = np.argsort(-support, kind="stable")
    flat = rotations.reshape(-1, 9)[left]
    kept: list[int] = []
    while len(left) and len(kept) < max_rotations:
        kept.append(left[0])
        apart = np.flatnonzero(flat @ flat[0] < min_trace)
        left, flat = left.take(apart), flat.take(apart, axis=0)
    return rotations[kept]
