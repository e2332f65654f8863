"""Rigid motions from few corresponding points or directions."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import make_transform
from skipnet.types import FloatArray


def fit_transforms(source_m: FloatArray, target_m: FloatArray, weights: FloatArray) -> FloatArray:
    """(S, 4, 4) least-squares motions of S weighted sets of (S, K, 3) correspondences (Kabsch)."""
    share = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float64)[..., None]
    centre_s, centre_t = (source_m * share).sum(axis=1), (target_m * share).sum(axis=1)
    moved_s, moved_t = source_m - centre_s[:, None], target_m - centre_t[:, None]
    rotation = best_rotations(moved_t.transpose(0, 2, 1) @ (share * moved_s))
    return make_transform(rotation, centre_t - (rotation @ centre_s[..., None])[..., 0])


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
