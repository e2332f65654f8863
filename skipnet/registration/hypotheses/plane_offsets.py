"""What the offsets of planes say about the translation, once the rotation is known."""

from __future__ import annotations

import numpy as np

from skipnet.features.primitives import Planes
from skipnet.types import FloatArray


def offset_constraints(
    rotation: FloatArray, source: Planes, target: Planes, max_angle_rad: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What each pair of parallel planes asks of the translation: n . t = shift, with a weight.

    Returns:
        (P, 3) target normals, (P,) shifts in metres, (P,) square roots of the shared area.
    """
    cosine = target.normals @ (source.normals @ rotation.T).T
    t, s = np.nonzero(cosine > np.cos(1.5 * max_angle_rad))
    normals = target.normals[t]
    moved_m = source.centroids_m[s] @ rotation.T
    shift_m = target.offsets_m[t] - (normals * moved_m).sum(axis=1)
    return normals, shift_m, np.sqrt(np.minimum(target.weights[t], source.weights[s]))


def main_directions(normals: FloatArray, weights: FloatArray, count: int = 5) -> FloatArray:
    """(D, 3) directions of much area, at least 20 degrees apart, either sign."""
    free = np.ones(len(normals), dtype=bool)
    axes: list[FloatArray] = []
    while free.any() and len(axes) < count:
        axes.append(normals[np.where(free, weights, -1).argmax()])
        free &= np.abs(normals @ axes[-1]) < np.cos(np.deg2rad(20))
    return np.array(axes)


def vote(
    along: FloatArray, shift_m: FloatArray, weights: FloatArray, width_m: float, count: int = 16
) -> tuple[FloatArray, FloatArray]:
    """The ``count`` shifts along a direction with most weight within ``width_m``, and that weight.

    Args:
        along: (P,) cosine between each pair's normal and the direction; parallel ones of either
            sign vote.
        shift_m: (P,) shift along its own normal that each pair asks for.
        weights: (P,) of the pairs.
        width_m: shifts closer than this support each other.
        count: peaks to return.
    """
    parallel = np.abs(along) > np.cos(0.12)
    offsets_m, weights = shift_m[parallel] * np.sign(along[parallel]), weights[parallel]
    near = np.abs(offsets_m[:, None] - offsets_m) < width_m
    support = near @ weights
    mean_m = (near @ (weights * offsets_m)) / support
    order = np.argsort(-support, kind="stable")
    mean_m, support = mean_m[order], support[order]
    apart = np.abs(mean_m[:, None] - mean_m) > width_m
    left, peaks = np.ones(len(mean_m), dtype=bool), list[int]()
    while left.any() and len(peaks) < count:
        peaks.append(int(left.argmax()))
        left &= apart[peaks[-1]]
        left[peaks[-1]] = False
    return mean_m[peaks], support[peaks]
