"""Candidate poses that a pose suggests: what repeats fits as well one repeat on, or turned.

From bay to bay of a hall, from step to step of a stair, from side to side of a pedestal, a pose may
be moved or turned and much agrees again. Other generators propose what agrees most, and that is the
pose that brings both sensors to the same place of the pattern. So voxels that are worth most vote
for translations, under the pose's own rotation and under its turns about the main axis: where many
meet at once, a rival is worth the judge's time.
"""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.registration.hypotheses.hypotheses import Hypotheses, concatenate
from skipnet.scans.evidence import Evidence
from skipnet.types import FloatArray, IntArray

VOTERS = 700
"""Voxels of each scan, those with much worth first."""
CELL_VOXELS = 1.5
"""Edge of the cells in which translations meet."""
MIN_COSINE = 0.9
"""Of the normals of two voxels that may be the same."""
MOST_PER_TURN = 250
"""Translations of each rotation."""
TURNS_RAD = np.deg2rad([0.0, 60.0, 90.0, 120.0, 180.0, 240.0, 270.0, 300.0])
"""About the main axis: what has three, four or six sides."""
MIN_TRUST = 0.5
"""In both viewpoints, for normals to tell the two sides of a wall apart."""
FEW_VOTES = 2
_BUCKETS, _HASH = 1 << 18, 73_856_093


def from_repeats(T_target_source: FloatArray, source: Evidence, target: Evidence) -> Hypotheses:
    """Translations of a pose, and of its turns, under which many voxels meet.

    Args:
        T_target_source: (4, 4) the pose.
        source: its voxels that say most come first, mostly.
        target: likewise.
    """
    oriented = min(source.trust, target.trust) > MIN_TRUST
    there_m, there_normals = target.points_m[:VOTERS], target.normals[:VOTERS]
    axis, found = main_axis(target.normals), []
    shape = (_BUCKETS, 3)
    ballot = np.zeros(_BUCKETS, np.int32), np.zeros(shape, np.int32), np.zeros(shape)
    for turn_rad in TURNS_RAD:
        rotation = rotation_from_vector(turn_rad * axis) @ T_target_source[:3, :3]
        turned = rotation.astype(np.float32).T
        shifts_m, votes = _translations(
            (source.points_m[:VOTERS] @ turned, source.normals[:VOTERS] @ turned),
            (there_m, there_normals),
            CELL_VOXELS * target.voxel_size_m,
            oriented,
            ballot,
        )
        best = np.argsort(-votes, kind="stable")[:MOST_PER_TURN]
        rotations = np.broadcast_to(rotation, (len(best), 3, 3))
        found.append(Hypotheses(make_transform(rotations, shifts_m[best]), votes[best]))
    return concatenate(found)


def main_axis(normals: FloatArray) -> FloatArray:
    """(3,) the direction about which the surfaces with (V, 3) normals are most alike all round.

    Of the principal axes of the normals the one whose share differs most from the other two: up
    in a room, along a pipe.
    """
    share, axes = np.linalg.eigh(normals.T.astype(np.float64) @ normals)
    return axes[:, 0] if share[1] - share[0] > share[2] - share[1] else axes[:, 2]


def _translations(
    source: tuple[FloatArray, FloatArray],
    target: tuple[FloatArray, FloatArray],
    cell_m: float,
    oriented: bool,
    ballot: tuple[IntArray, IntArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """(K, 3) mean translations of the cells that more than two pairs of voxels vote for, and (K,)
    their votes; a voxel is a point and a normal. The ballot is without votes before and after."""
    votes, _, total_m = ballot
    _vote(source, target, cell_m, oriented, ballot)
    used = np.flatnonzero(votes)
    rows = used[votes[used] > FEW_VOTES]
    means_m, counts = total_m[rows] / votes[rows, None], votes[rows].astype(np.float64)
    votes[used], total_m[used] = 0, 0.0
    return means_m, counts


@compiled
def _vote(
    source: tuple[FloatArray, FloatArray],
    target: tuple[FloatArray, FloatArray],
    cell_m: float,
    oriented: bool,
    ballot: tuple[IntArray, IntArray, FloatArray],
) -> None:
    """Count the votes for each hashed cell, which cell it is and the sum of its translations, into
    zeros; of the cells that share a bucket the first one alone has votes."""
    votes, cells, total_m = ballot
    shift_m, cell = np.empty(3), np.empty(3, dtype=np.int32)
    for s in range(len(source[0])):
        for t in range(len(target[0])):
            cosine = 0.0
            for i in range(3):
                cosine += source[1][s, i] * target[1][t, i]
            if (cosine if oriented else abs(cosine)) < MIN_COSINE:
                continue
            bucket, same = 0, True
            for i in range(3):
                shift_m[i] = target[0][t, i] - source[0][s, i]
                cell[i] = np.int32(np.floor(shift_m[i] / cell_m))
                bucket = bucket * _HASH + cell[i]
            bucket = (bucket ^ (bucket >> 17)) & (_BUCKETS - 1)
            for i in range(3):
                if votes[bucket] == 0:
                    cells[bucket, i] = cell[i]
                same = same and cells[bucket, i] == cell[i]
            if same:
                votes[bucket] += 1
                for i in range(3):
                    total_m[bucket, i] += shift_m[i]
