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
    ballot = np.zeros((_BUCKETS, 2), np.int64)
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
    ballot: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """(K, 3) mean translations of the cells that more than two pairs of voxels vote for, and (K,)
    their votes; a voxel is a point and a normal. The ballot is without votes before and after."""
    target = target[0], np.ascontiguousarray(target[1].T)
    cosine = np.empty(len(target[0]), dtype=np.float32)
    voters = np.empty((len(source[0]) * len(cosine), 3), np.int32)
    count = _vote(source, target, cell_m, oriented, ballot, cosine, voters)
    most = count // (FEW_VOTES + 1)
    buckets, votes, total_m = np.empty(most, np.int64), np.empty(most), np.zeros((most, 3))
    cells = _count(source[0], target[0], voters[:count], ballot, (buckets, votes, total_m))
    in_order = np.argsort(buckets[:cells])
    return (total_m[in_order] / votes[in_order, None]), votes[in_order]


@compiled
def _vote(
    source: tuple[FloatArray, FloatArray],
    target: tuple[FloatArray, FloatArray],
    cell_m: float,
    oriented: bool,
    ballot: IntArray,
    cosine: FloatArray,
    voters: IntArray,
) -> int:
    """Count the votes for each hashed cell, into (B, 2) zeros: which cell it is, and how many; of
    the cells that share a bucket the first one alone has votes. The target's normals are (3, T).

    Returns:
        How many voted; ``voters`` are their buckets and voxels.
    """
    there_m, normals = target
    count = 0
    for s in range(len(source[0])):
        x_m, y_m, z_m = source[0][s]
        n_x, n_y, n_z = source[1][s]
        for t in range(len(cosine)):
            cosine[t] = n_x * normals[0, t] + n_y * normals[1, t] + n_z * normals[2, t]
        for t in range(len(cosine)):
            if (cosine[t] if oriented else abs(cosine[t])) < MIN_COSINE:
                continue
            i = int(np.floor((there_m[t, 0] - x_m) / cell_m))
            j = int(np.floor((there_m[t, 1] - y_m) / cell_m))
            k = int(np.floor((there_m[t, 2] - z_m) / cell_m))
            cell = (i * _HASH + j) * _HASH + k
            bucket = (cell ^ (cell >> 17)) & (_BUCKETS - 1)
            if ballot[bucket, 1] == 0:
                ballot[bucket, 0] = cell
            if ballot[bucket, 0] == cell:
                ballot[bucket, 1] += 1
                voters[count, 0], voters[count, 1], voters[count, 2] = bucket, s, t
                count += 1
    return count


@compiled
def _count(
    source_m: FloatArray,
    target_m: FloatArray,
    voters: IntArray,
    ballot: IntArray,
    cells: tuple[IntArray, FloatArray, FloatArray],
) -> int:
    """Write down of each cell with more than a few votes its bucket, its votes, and the sum of its
    translations, into zeros; and clear the ballot. Returns how many there are."""
    buckets, votes, total_m = cells
    count = 0
    for v in range(len(voters)):
        ballot[voters[v, 0], 0] = -1
    for v in range(len(voters)):
        bucket, s, t = voters[v]
        if ballot[bucket, 1] > FEW_VOTES:
            if ballot[bucket, 0] < 0:
                ballot[bucket, 0] = count
                buckets[count], votes[count] = bucket, ballot[bucket, 1]
                count += 1
            for i in range(3):
                total_m[ballot[bucket, 0], i] += target_m[t, i] - source_m[s, i]
    for v in range(len(voters)):
        ballot[voters[v, 0]] = 0
    return count
