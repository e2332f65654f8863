"""Candidate poses that a pose suggests: what repeats fits as well one repeat on, or turned.

From bay to bay of a hall, from step to step of a stair, from side to side of a pedestal, a pose may
be moved or turned and much agrees again. Other generators propose what agrees most, and that is the
pose that brings both sensors to the same place of the pattern. So voxels that are worth most vote
for translations, under the pose's own rotation and under its turns about the main axis: where many
meet at once, a rival is worth the judge's time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.clouds.statistics import largest
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
_UNCOUNTED = 255
"""So many votes, and more, are one to a tally."""
_BUCKETS, _HASH = 1 << 18, 73_856_093


def from_repeats(T_target_source: FloatArray, source: Evidence, target: Evidence) -> Hypotheses:
    """Translations of a pose, and of its turns, under which many voxels meet.

    Args:
        T_target_source: (4, 4) the pose.
        source: its voxels that say most come first, mostly.
        target: likewise.
    """
    oriented = min(source.trust, target.trust) > MIN_TRUST
    there = target.points_m[:VOTERS].T.copy(), target.normals[:VOTERS].T.copy()
    axis, found, ballot = main_axis(target.normals), [], _Ballot.empty()
    for turn_rad in TURNS_RAD:
        rotation = rotation_from_vector(turn_rad * axis) @ T_target_source[:3, :3]
        turned = rotation.astype(np.float32).T
        shifts_m, votes = _translations(
            (source.points_m[:VOTERS] @ turned, source.normals[:VOTERS] @ turned),
            there,
            CELL_VOXELS * target.voxel_size_m,
            oriented,
            ballot,
        )
        best = largest(votes, MOST_PER_TURN)
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


@dataclass(frozen=True)
class _Ballot:
    """What votes are counted in, turn after turn: without votes before and after each."""

    tally: IntArray
    """(B,) uint8 votes for each bucket, whatever the cell, as far as they can be counted."""
    cells: IntArray
    """(B, 2) of what has more than a few: which cell, the first in its bucket, and its votes."""
    voters: IntArray
    """(P, 3) int32 bucket and voxels of each vote ..."""
    keys: IntArray
    """(P,) ... and the cell."""

    @staticmethod
    def empty() -> _Ballot:
        """Room for the votes of all pairs."""
        most = VOTERS * VOTERS
        tally, cells = np.zeros(_BUCKETS, np.uint8), np.zeros((_BUCKETS, 2), np.int64)
        return _Ballot(tally, cells, np.empty((most, 3), np.int32), np.empty(most, np.int64))


def _translations(
    source: tuple[FloatArray, FloatArray],
    target: tuple[FloatArray, FloatArray],
    cell_m: float,
    oriented: bool,
    ballot: _Ballot,
) -> tuple[FloatArray, FloatArray]:
    """(K, 3) mean translations of the cells that more than two pairs of voxels vote for, and (K,)
    their votes; the source's points and normals are (S, 3), the target's (3, T)."""
    size = target[0].shape[1]
    room = np.empty(size, np.float32), np.empty(size, np.int32), np.empty((3, size))
    voters, tally, reached = ballot.voters, ballot.tally, np.zeros(_UNCOUNTED + 1, np.int64)
    count = _vote(source, target, cell_m, oriented, room, (tally, reached), voters, ballot.keys)
    # As some buckets are shared, four times as many as are kept have the least votes to count.
    enough = np.flatnonzero(reached[:_UNCOUNTED] >= 4 * MOST_PER_TURN)
    least = max(FEW_VOTES + 1, enough.max(initial=0))
    voters = voters[: _elect(voters[:count], ballot.keys, least, tally, ballot.cells)]
    most = len(voters) // (FEW_VOTES + 1)
    buckets, votes, total_m = np.empty(most, np.int64), np.empty(most), np.zeros((most, 3))
    cells = _count(source[0], target[0], voters, ballot.cells, (buckets, votes, total_m))
    in_order = np.argsort(buckets[:cells])
    return (total_m[in_order] / votes[in_order, None]), votes[in_order]


@compiled
def _vote(
    source: tuple[FloatArray, FloatArray],
    target: tuple[FloatArray, FloatArray],
    cell_m: float,
    oriented: bool,
    room: tuple[FloatArray, IntArray, FloatArray],
    tallies: tuple[IntArray, IntArray],
    voters: IntArray,
    keys: IntArray,
) -> int:
    """Write down all votes, and tally them by hashed cell, and how many buckets have so many; how
    many votes there are. What belongs to one voxel of the source is worked out together, in a room
    for (T,), (T,) and (3, T)."""
    (xs_m, ys_m, zs_m), normals = target[0], target[1]
    (cosine, alike, places), (tally, reached) = room, tallies
    count = 0
    for s in range(len(source[0])):
        x_m, y_m, z_m = source[0][s]
        n_x, n_y, n_z = source[1][s]
        for t in range(len(cosine)):
            cosine[t] = n_x * normals[0, t] + n_y * normals[1, t] + n_z * normals[2, t]
        votes = 0
        for t in range(len(cosine)):
            alike[votes] = t
            votes += (cosine[t] if oriented else abs(cosine[t])) >= MIN_COSINE
        for v in range(votes):
            t = alike[v]
            places[0, v] = (xs_m[t] - x_m) / cell_m
            places[1, v] = (ys_m[t] - y_m) / cell_m
            places[2, v] = (zs_m[t] - z_m) / cell_m
        for v in range(votes):
            i, j = int(np.floor(places[0, v])), int(np.floor(places[1, v]))
            keys[count + v] = (i * _HASH + j) * _HASH + int(np.floor(places[2, v]))
        for v in range(votes):
            cell = keys[count + v]
            bucket = (cell ^ (cell >> 17)) & (_BUCKETS - 1)
            tally[bucket] += tally[bucket] < _UNCOUNTED
            reached[tally[bucket]] += 1
            vote = voters[count + v]
            vote[0], vote[1], vote[2] = bucket, s, alike[v]
        count += votes
    return count


@compiled
def _elect(voters: IntArray, keys: IntArray, least: int, tally: IntArray, ballot: IntArray) -> int:
    """Count the votes in each bucket that has so many at least, into (B, 2) zeros: which cell it
    is, and how many; of the cells that share a bucket the first one alone has votes. And clear the
    tally. Returns how many voted; they come first in ``voters``."""
    count = 0
    for v in range(len(voters)):
        bucket, s, t = voters[v]
        if tally[bucket] >= least:
            if ballot[bucket, 1] == 0:
                ballot[bucket, 0] = keys[v]
            if ballot[bucket, 0] == keys[v]:
                ballot[bucket, 1] += 1
                voters[count, 0], voters[count, 1], voters[count, 2] = bucket, s, t
                count += 1
    for bucket in range(len(tally)):
        tally[bucket] = 0
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
    translations, into zeros; and clear the ballot. Returns how many there are. The source's points
    are (S, 3), the target's (3, T)."""
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
                total_m[ballot[bucket, 0], i] += target_m[i, t] - source_m[s, i]
    for v in range(len(voters)):
        ballot[voters[v, 0]] = 0
    return count
