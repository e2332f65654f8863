"""Rotations that lay the planes of one scan on those of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.clouds.statistics import largest
from skipnet.compiled import compiled
from skipnet.features.primitives import Planes
from skipnet.registration.hypotheses.fitting import best_rotations, bisector_frames
from skipnet.types import FloatArray, IntArray

MOST_TRIED = 3000
"""Pairs of two planes in either scan, those of most area."""
_COUNT_ONLY = np.empty((2, 0), dtype=np.int32)
_AT_ONCE = 1 << 15
"""Pairs of planes, over all rotations, looked at in one go: they stay in the processor's cache."""


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
    p, q = _equal_angles(angle_s, angle_t, max_angle_rad)
    if len(p) == 0:
        return np.zeros((0, 3, 3))
    weight = np.minimum(source.weights[i[p]], target.weights[k[q]]) * np.minimum(
        source.weights[j[p]], target.weights[m[q]]
    )
    best = largest(weight, MOST_TRIED)
    p, q = p[best], q[best]
    frames_t = bisector_frames(target.normals[k[q]], target.normals[m[q]])
    frames_s = bisector_frames(source.normals[i[p]], source.normals[j[p]])
    rotations: FloatArray = frames_t @ frames_s.transpose(0, 2, 1)
    pairs = _PlanePairs.of(source, target, np.cos(1.5 * max_angle_rad))
    at_once = max(1, _AT_ONCE // (len(source) * len(target)))
    starts = range(0, len(rotations), at_once)
    support = np.concatenate(
        [pairs.support(rotations[start : start + at_once]) for start in starts]
    )
    aligned = support >= min_share * support.max()
    rotations = _distinct_rotations(
        rotations[aligned], support[aligned], max_rotations, 1.5 * max_angle_rad
    )
    return best_rotations((pairs.shared_area(rotations) @ pairs.products.T).reshape(-1, 3, 3))


def _equal_angles(
    angle_s: FloatArray, angle_t: FloatArray, max_angle_rad: float
) -> tuple[IntArray, IntArray]:
    """(K,) rows of (S,) angles and (K,) of (T,) others that differ by less than a limit."""
    pairs = np.empty((2, _list_equal(angle_s, angle_t, max_angle_rad, _COUNT_ONLY)), np.int32)
    _list_equal(angle_s, angle_t, max_angle_rad, pairs)
    return pairs[0], pairs[1]


@compiled
def _list_equal(
    angle_s: FloatArray, angle_t: FloatArray, max_angle_rad: float, pairs: IntArray
) -> int:
    """Write the pairs of ``_equal_angles`` if there is room; how many there are."""
    count = 0
    for s in range(len(angle_s)):
        equal = 0
        for t in range(len(angle_t)):
            equal += abs(angle_s[s] - angle_t[t]) < max_angle_rad
        if equal > 0 and pairs.shape[1] > 0:
            place = count
            for t in range(len(angle_t)):
                if abs(angle_s[s] - angle_t[t]) < max_angle_rad:
                    pairs[0, place], pairs[1, place] = s, t
                    place += 1
        count += equal
    return count


def oblique_pairs(normals: FloatArray, ordered: bool) -> tuple[IntArray, IntArray]:
    """Index pairs of normals at least 20 degrees from parallel."""
    sine = np.linalg.norm(np.cross(normals[:, None], normals[None]), axis=-1)
    pairs = sine > np.sin(np.deg2rad(20))
    first, second = np.nonzero(pairs if ordered else np.triu(pairs))
    return first, second


@dataclass(frozen=True)
class _PlanePairs:
    """All pairs of a plane of the target, T of them, and one of the source, S."""

    products: FloatArray
    """(9, T * S) outer products of their normals: a rotation's 9 entries times these is how well it
    aligns them."""
    area: FloatArray
    """(T, S) the smaller one's."""
    min_cosine: float
    """Of the angle between aligned planes."""

    @staticmethod
    def of(source: Planes, target: Planes, min_cosine: float) -> _PlanePairs:
        """The pairs of two scans' planes."""
        products = np.einsum("ti,sj->ijts", target.normals, source.normals)
        area = np.minimum(target.weights[:, None], source.weights)
        return _PlanePairs(products.reshape(9, -1), area, min_cosine)

    def support(self, rotations: FloatArray) -> FloatArray:
        """(R,) sums of ``shared_area``."""
        return _sum_of_best(rotations.reshape(-1, 9) @ self.products, self.area, self.min_cosine)

    def shared_area(self, rotations: FloatArray) -> FloatArray:
        """(R, T * S) area that each source plane shares with the one target plane along it with
        which it shares most; with all of them where these are equal.

        Args:
            rotations: (R, 3, 3).
        """
        cosine = (rotations.reshape(-1, 9) @ self.products).reshape(-1, *self.area.shape)
        shared = np.multiply(cosine > self.min_cosine, self.area)
        shared *= shared == shared.max(axis=1, keepdims=True)
        return shared.reshape(len(rotations), -1)


@compiled
def _sum_of_best(cosine: FloatArray, area: FloatArray, min_cosine: float) -> FloatArray:
    """(R,) over S source planes, the largest (T, S) area among the target planes along them, as
    often as it comes; (R, T * S) cosines tell what is along."""
    sums, (targets, sources) = np.zeros(len(cosine)), area.shape
    best, count = np.empty(sources), np.empty(sources)
    for r in range(len(cosine)):
        best[:], count[:] = 0, 0
        for t in range(targets):
            along, shared = cosine[r, t * sources : (t + 1) * sources], area[t]
            for s in range(sources):
                here = shared[s] if along[s] > min_cosine else 0.0
                again = count[s] + (1.0 if here == best[s] else 0.0)
                count[s] = 1.0 if here > best[s] else again
                best[s] = max(best[s], here)
        for s in range(sources):
            sums[r] += best[s] * count[s]
    return sums


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
