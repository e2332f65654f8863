"""Hypotheses: candidate poses, all of one type, and those that correspondences propose.

A generator takes what two scans show and returns a stack of ``T_target_source`` with weights; it
never judges. What one proposes is judged together with what the others do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skipnet.compiled import compiled, inlined
from skipnet.registration.hypotheses.fitting import fit_transforms
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses
from skipnet.types import BoolArray, FloatArray, IntArray

MAX_TURNED = np.float32(0.2)
"""How much the cosine of an angle between surfaces may differ from one scan to the other. Of 98
simulated pairs (half of them of less than 35 % overlap) the matcher's correspondences propose a
pose near the truth for 73 without, 77 with 0.35 and 78 with 0.2."""


class Facing(NamedTuple):
    """Which way the surfaces face at K correspondences."""

    source: FloatArray
    """(K, 3) unit normals ..."""
    target: FloatArray
    """(K, 3) ... and those of the target."""
    sides_known: bool
    """Whether their signs say anything."""


def from_correspondences(
    source_m: FloatArray,
    target_m: FloatArray,
    weights: FloatArray,
    max_distance_m: float,
    seeds: int = 120,
    support: int = 20,
    facing: Facing | None = None,
) -> Hypotheses:
    """Poses from sets of correspondences that agree with each other: second-order compatibility.

    Two correspondences are compatible when they keep their distance and, where it is known which
    way the surfaces face, the angles between these and the line that joins them; they support
    each other by the number of third ones compatible with both (SC2-PCR, Chen et al., CVPR 2022).
    Each seed's strongest supporters give one pose by weighted least squares.

    Args:
        source_m: (K, 3) points of the source ...
        target_m: (K, 3) ... and the target points they may correspond to.
        weights: (K,) prior trust in each correspondence.
        max_distance_m: largest change of distance between compatible correspondences.
        seeds: correspondences to start from.
        support: correspondences that enter each pose, the seed included.
        facing: of the surfaces that correspond.

    Returns:
        At most ``seeds`` candidates; none from fewer than three correspondences.
    """
    if len(source_m) < 3:
        return NO_HYPOTHESES
    compatible = np.empty((len(source_m), len(source_m)), dtype=bool)
    places = _columns(source_m), _columns(target_m), np.float32(max_distance_m)
    _keep_distance(*places, compatible)
    if facing is not None:
        of_source, of_target = (
            axes.T.astype(np.float32, order="C") for axes in (facing.source, facing.target)
        )
        _keep_angles(*places, of_source, of_target, facing.sides_known, compatible)
    second = common_neighbours(compatible)
    chosen = np.argsort(-(second @ weights.astype(np.float32)), kind="stable")[:seeds]
    np.fill_diagonal(second, np.inf)
    members = np.argsort(-second[chosen], axis=1, kind="stable")[:, :support]
    strength = np.minimum(np.take_along_axis(second[chosen], members, axis=1), len(source_m))
    usable = (strength > 0).sum(axis=1) >= 3
    chosen, members, strength = chosen[usable], members[usable], strength[usable]
    T_target_source = fit_transforms(source_m[members], target_m[members], strength)
    return Hypotheses(T_target_source, strength.sum(axis=1))


def _columns(points_m: FloatArray) -> FloatArray:
    """(3, K) float32 coordinates of (K, 3) points about their mean."""
    return (points_m - points_m.mean(axis=0)).T.astype(np.float32, order="C")


@compiled
def _keep_distance(
    source_m: FloatArray, target_m: FloatArray, max_change_m: np.float32, compatible: BoolArray
) -> None:
    """Which two of K correspondences are about as far apart in one scan as in the other, into
    (K, K); none from itself. Points are (3, K)."""
    a_x, a_y, a_z = source_m[0], source_m[1], source_m[2]
    b_x, b_y, b_z = target_m[0], target_m[1], target_m[2]
    for i in range(len(compatible)):
        x, y, z, u, v, w = a_x[i], a_y[i], a_z[i], b_x[i], b_y[i], b_z[i]
        row = compatible[i]
        for j in range(len(row)):
            d, e, f = a_x[j] - x, a_y[j] - y, a_z[j] - z
            p, q, r = b_x[j] - u, b_y[j] - v, b_z[j] - w
            change_m = np.sqrt(d * d + e * e + f * f) - np.sqrt(p * p + q * q + r * r)
            row[j] = abs(change_m) < max_change_m
        row[i] = False


@compiled
def _keep_angles(
    source_m: FloatArray,
    target_m: FloatArray,
    near_m: np.float32,
    source_axes: FloatArray,
    target_axes: FloatArray,
    sides_known: bool,
    compatible: BoolArray,
) -> None:
    """Of correspondences that keep their distance, (K, K), those whose surfaces face each other as
    they do in the other scan, and the line that joins them, if that is long enough to say.
    Points and axes are (3, K)."""
    for i in range(len(compatible)):
        for j in range(i):
            if compatible[i, j]:
                far_m, both_s, own_s, other_s = _angles(source_m, source_axes, i, j)
                _, both_t, own_t, other_t = _angles(target_m, target_axes, i, j)
                kept = _is_kept(both_s, both_t, sides_known)
                if kept and far_m > 2 * near_m:
                    kept = _is_kept(own_s, own_t, sides_known)
                    kept = kept and _is_kept(other_s, other_t, sides_known)
                compatible[i, j] = compatible[j, i] = kept


@inlined
def _angles(
    places_m: FloatArray, axes: FloatArray, i: int, j: int
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """How far j is from i, the cosine between their surfaces, and those with the line to j."""
    d, e, f = (
        places_m[0, j] - places_m[0, i],
        places_m[1, j] - places_m[1, i],
        places_m[2, j] - places_m[2, i],
    )
    x, y, z = axes[0, i], axes[1, i], axes[2, i]
    u, v, w = axes[0, j], axes[1, j], axes[2, j]
    far_m = np.sqrt(d * d + e * e + f * f)
    per_m = np.float32(1) / max(far_m, np.float32(1e-12))
    own, other = (x * d + y * e + z * f) * per_m, (u * d + v * e + w * f) * per_m
    return far_m, x * u + y * v + z * w, own, other


@inlined
def _is_kept(here: np.float32, there: np.float32, sides_known: bool) -> bool:
    """Whether an angle's cosine is about the same in both scans."""
    return bool(abs(here - there if sides_known else abs(here) - abs(there)) <= MAX_TURNED)


def common_neighbours(compatible: BoolArray) -> FloatArray:
    """(K, K) float32: of each two that are compatible, by a symmetric matrix, how many others are
    compatible with both; 0 for all others.

    A matrix product would count all pairs', and few are compatible.
    """
    padded = np.pad(compatible, ((0, 0), (0, -len(compatible) % 64)))
    second = np.zeros(compatible.shape, dtype=np.float32)
    _count_common(compatible, np.packbits(padded, axis=1).view(np.uint64), second)
    return second


@inlined
def _ones(bits: np.uint64) -> np.uint64:
    """How many of 64 bits are set."""
    bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
    fours = np.uint64(0x3333333333333333)
    bits = (bits & fours) + ((bits >> np.uint64(2)) & fours)
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (bits * np.uint64(0x0101010101010101)) >> np.uint64(56)


@compiled
def _count_common(compatible: BoolArray, bits: IntArray, second: FloatArray) -> None:
    """See ``common_neighbours``; by the (K, N) bits of its rows, 64 at a time, into zeros."""
    for i in range(len(bits)):
        for j in range(i):
            if compatible[i, j]:
                count = np.uint64(0)
                for w in range(bits.shape[1]):
                    count += _ones(bits[i, w] & bits[j, w])
                second[i, j] = second[j, i] = count
