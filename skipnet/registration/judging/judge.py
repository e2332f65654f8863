"""The one judge: how well a candidate pose explains both scans, whoever proposed it.

A pose earns the share of each scan's voxels that land on the other scan's surface with agreeing
oriented normals, and pays for every voxel that lands where the other sensor saw free space. The
payment decides between look-alike poses: overlap alone cannot tell the four turns of a square room
apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import invert
from skipnet.parallel.threads import side_by_side
from skipnet.scans.evidence import Evidence
from skipnet.types import BoolArray, FloatArray, IntArray

_SOON_JUDGED = 1 << 13
"""Voxels, over all candidates, that are judged before another thread has begun."""
_AT_ONCE = 1 << 20
"""Voxels, over all candidates, judged in one go: some megabytes."""
HOPELESS = 0.1
"""A candidate that scores less than this share of the best one's will not overtake it: right poses
score a third of it and more, before any refinement, in doorways and on streets too."""
STRAY_SHARE = 0.0003
"""Share of voxels that may contradict by chance: one of 4000 samples."""


@dataclass(frozen=True)
class Strictness:
    """What counts as agreement and what as a contradiction."""

    max_distance_voxels: float
    """Largest distance from the other scan's local plane."""
    min_normal_cosine: float
    """Smallest cosine between matching normals."""
    free_share: float
    """A point in front of what was seen there by this share of the range ..."""
    free_voxels: float
    """... and by this many voxels is in free space."""


ROUGH = Strictness(1.0, 0.8, 0.03, 1.5)
"""For candidates, which may be a voxel off."""
FINE = Strictness(0.5, 0.8, 0.02, 1.0)
"""For poses after fine alignment."""


@dataclass(frozen=True)
class Score:
    """The judge's figures for C candidates; every array is (C,)."""

    total: FloatArray
    """Overlap, discounted for violations: overlap * exp(-weight * severity), 0 to 1."""
    overlap: FloatArray
    """Mean of both ways' matched shares, 0 to 1."""
    violation: FloatArray
    """Mean of both ways' shares that contradict seen free space, 0 to 1."""


def judge(
    T_target_source: FloatArray,
    source: Evidence,
    target: Evidence,
    samples: int,
    violation_weight: float,
    strictness: Strictness = ROUGH,
) -> Score:
    """Score candidate poses by what both scans say about them.

    Args:
        T_target_source: (C, 4, 4) candidates.
        source: the source's evidence.
        target: the target's evidence.
        samples: voxels to look at in each scan; the first so many of its sampling order.
        violation_weight: how fast contradictions devalue a pose: at a severity of 1 / weight
            its overlap counts for 37 % (1 / e).
        strictness: what counts as agreement and as a contradiction.
    """

    at_once = max(1, _AT_ONCE // max(1, samples))

    def one_way(T_b_a: FloatArray, a: Evidence, b: Evidence) -> FloatArray:
        """(2, C) what ``_one_way`` says of all candidates, some at a time."""
        some = [T_b_a[i : i + at_once] for i in range(0, max(1, len(T_b_a)), at_once)]
        return np.hstack([_one_way(T, a, b, samples, strictness) for T in some])

    is_long = samples * len(T_target_source) > _SOON_JUDGED
    there, back = (side_by_side if is_long else map)(
        one_way, (T_target_source, invert(T_target_source)), (source, target), (target, source)
    )
    overlap, violation = 0.5 * (there + back)
    return Score(overlap * np.exp(-violation_weight * severity(violation)), overlap, violation)


def severity(violation: FloatArray) -> FloatArray:
    """How much shares of violating voxels say against a pose.

    It grows as the square root does: the first few contradictions say most, because right poses of
    still scenes have none at all, while in a busy street even the right one has some per cent. A
    stray voxel or two say little.

    >>> severity(np.array([0.0, 0.0001, 0.01])).round(3)
    array([0.   , 0.003, 0.084])
    """
    return np.sqrt(violation + STRAY_SHARE) - np.sqrt(STRAY_SHARE)


def shortlist(
    T_target_source: FloatArray,
    source: Evidence,
    target: Evidence,
    violation_weight: float,
    count: int = 20,
    rounds: tuple[tuple[int, int], ...] = ((24, 1000), (100, 400)),
    final_samples: int = 400,
) -> FloatArray:
    """Judge all with few samples, the better ones with more; keep the best distinct ones.

    Args:
        T_target_source: (C, 4, 4) candidates.
        source: the source's evidence.
        target: the target's evidence.
        violation_weight: as in ``judge``.
        count: candidates to keep at the end.
        rounds: (samples, candidates that stay) of each round but the last.
        final_samples: of the last round, among distinct candidates.

    Returns:
        (K, 4, 4) candidates, best first, no two within three voxels and three degrees.
    """
    for samples, stay in rounds:
        total = judge(T_target_source, source, target, samples, violation_weight).total
        best = np.argsort(-total, kind="stable")[:stay]
        T_target_source, total = T_target_source[best], total[best]
    T_target_source = T_target_source[total >= HOPELESS * total.max(initial=0.0)]
    # Before the last round, lest variants of one pose crowd out all others.
    T_target_source = T_target_source[
        distinct(T_target_source, source.centre_m, 3 * source.voxel_size_m)
    ]
    total = judge(T_target_source, source, target, final_samples, violation_weight).total
    best = np.argsort(-total, kind="stable")[:count]
    return T_target_source[best[total[best] >= HOPELESS * total.max(initial=0.0)]]


def distinct(
    T_target_source: FloatArray,
    centre_m: FloatArray,
    min_distance_m: float,
    min_angle_rad: float = 0.05,
) -> IntArray:
    """Rows of the poses that differ from every better one before them.

    Args:
        T_target_source: (C, 4, 4) candidates, best first.
        centre_m: (3,) centre of the source, which shows how far two poses are apart.
        min_distance_m: poses that move it apart by more are distinct ...
        min_angle_rad: ... and so are those turned by more.
    """
    rotations = T_target_source[:, :3, :3].reshape(-1, 9)
    moved_m = T_target_source[:, :3, :3] @ centre_m + T_target_source[:, :3, 3]
    apart_m = np.linalg.norm(moved_m[:, None] - moved_m, axis=2)
    same = (rotations @ rotations.T >= 1 + 2 * np.cos(min_angle_rad)) & (apart_m <= min_distance_m)
    left, kept = np.ones(len(T_target_source), dtype=bool), []
    for row in range(len(T_target_source)):
        if left[row]:
            kept.append(row)
            left &= ~same[row]
    return np.array(kept, dtype=np.int64)


def _one_way(
    T_b_a: FloatArray, a: Evidence, b: Evidence, samples: int, strictness: Strictness
) -> FloatArray:
    """(2, C) weighted shares of a's voxels that match b, and that violate b's free space."""
    row = b.near.find_moved(T_b_a, a.points_m, samples)
    weights = a.weights[: row.shape[1]]
    match = _match(
        T_b_a[:, :3].astype(np.float32),
        a.points_m,
        a.normals,
        row,
        b.surfaces,
        a.oriented and b.oriented,
        strictness.min_normal_cosine,
        strictness.max_distance_voxels * b.voxel_size_m,
    )
    free = np.zeros_like(match)
    if b.range_image is not None:
        free_m = strictness.free_voxels * b.voxel_size_m
        free = b.range_image.in_front(T_b_a, a.points_m, ~match, strictness.free_share, free_m)
    return np.stack([match, free]) @ (weights / weights.sum())


@compiled
def _match(
    T_b_a: FloatArray,
    points_a_m: FloatArray,
    normals_a: FloatArray,
    row: IntArray,
    surfaces_b: FloatArray,
    oriented: bool,
    min_normal_cosine: float,
    max_distance_m: float,
) -> BoolArray:
    """(C, S) which of a's voxels lie on the surface of b's voxels in (C, S) ``row``."""
    match = np.zeros(row.shape, dtype=np.bool_)
    for c in range(len(T_b_a)):
        T = T_b_a[c]
        for s in range(row.shape[1]):
            there = row[c, s]
            if there >= 0:
                n_x, n_y, n_z = surfaces_b[there, 0], surfaces_b[there, 1], surfaces_b[there, 2]
                # b's normal in the frame of a: one turn serves for the point and its normal.
                a_x = T[0, 0] * n_x + T[1, 0] * n_y + T[2, 0] * n_z
                a_y = T[0, 1] * n_x + T[1, 1] * n_y + T[2, 1] * n_z
                a_z = T[0, 2] * n_x + T[1, 2] * n_y + T[2, 2] * n_z
                cosine = a_x * normals_a[s, 0] + a_y * normals_a[s, 1] + a_z * normals_a[s, 2]
                offset_m = surfaces_b[there, 3] - T[0, 3] * n_x - T[1, 3] * n_y - T[2, 3] * n_z
                distance_m = a_x * points_a_m[s, 0] + a_y * points_a_m[s, 1]
                distance_m += a_z * points_a_m[s, 2] - offset_m
                if not oriented:
                    cosine = abs(cosine)
                match[c, s] = cosine > min_normal_cosine and abs(distance_m) <= max_distance_m
    return match
