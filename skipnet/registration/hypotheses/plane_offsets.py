"""What the offsets of planes say about the translation, once the rotation is known."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.primitives import Planes
from skipnet.types import BoolArray, FloatArray, IntArray

MOST_DIRECTIONS = 5
"""That planes of much area are sorted by."""
_MAX_COSINE = float(np.cos(np.deg2rad(20)))
"""Of the angle between two main directions."""
_MIN_COSINE = float(np.cos(0.12))
"""Of the angle between a pair's normal and a direction for which it votes."""


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


def main_directions(normals: FloatArray, weights: FloatArray) -> FloatArray:
    """(D, 3) directions of much area, at least 20 degrees apart, either sign."""
    left, chosen = np.ones(len(normals), dtype=bool), np.empty(MOST_DIRECTIONS, dtype=np.int64)
    return normals[chosen[: _choose_directions(normals, weights, left, chosen)]]


@compiled
def _choose_directions(
    normals: FloatArray, weights: FloatArray, left: BoolArray, chosen: IntArray
) -> int:
    """Write the rows of the directions with most area; how many. All of (P,) are left before."""
    for place in range(len(chosen)):
        best = -1
        for p in range(len(normals)):
            if left[p] and (best < 0 or weights[p] > weights[best]):
                best = p
        if best < 0:
            return place
        chosen[place] = best
        x, y, z = normals[best]
        for p in range(len(normals)):
            cosine = abs(normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z)
            left[p] = left[p] and cosine < _MAX_COSINE
    return len(chosen)


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
    peaks, room = np.empty((2, count)), np.empty((5, len(along)))
    found = _vote(along, shift_m, weights, width_m, room, peaks)
    return peaks[0, :found], peaks[1, :found]


@compiled
def _vote(
    along: FloatArray,
    shift_m: FloatArray,
    weights: FloatArray,
    width_m: float,
    room: FloatArray,
    peaks: FloatArray,
) -> int:
    """See ``vote``: how many peaks were found, of (2, K) means and weights; the room is (5, P)."""
    offsets_m, own, support, mean_m, left = room[0], room[1], room[2], room[3], room[4]
    voters = 0
    for p in range(len(along)):
        if abs(along[p]) > _MIN_COSINE:
            offsets_m[voters] = shift_m[p] if along[p] > 0 else -shift_m[p]
            own[voters], left[voters] = weights[p], 1.0
            voters += 1
    for p in range(voters):
        support[p] = mean_m[p] = 0.0
        for q in range(voters):
            near = own[q] if abs(offsets_m[p] - offsets_m[q]) < width_m else 0.0
            support[p] += near
            mean_m[p] += near * offsets_m[q]
        mean_m[p] /= support[p]
    for peak in range(peaks.shape[1]):
        best = -1
        for p in range(voters):
            if left[p] > 0 and (best < 0 or support[p] > support[best]):
                best = p
        if best < 0:
            return peak
        peaks[0, peak], peaks[1, peak] = mean_m[best], support[best]
        for p in range(voters):
            if abs(mean_m[p] - mean_m[best]) <= width_m:
                left[p] = 0.0
    return peaks.shape[1]
