"""Motions against which few normals hold a pose: the judge finds the place, or finds that none is.

Two rooms through a doorway touch in the door's frame alone. Hardly any surface there faces along
the wall, yet what each sensor saw past the frame tells where the other room must be. In a corridor
nothing does. A tank's normals hold no turn about its axis, but for their noise; its hatch does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.registration.judging.judge import Judge
from skipnet.types import BoolArray, FloatArray

MIN_DETERMINED = 0.01
"""A direction that less than this share of the normals faces is weak: noise can hold it ..."""
MIN_DETERMINING_VOXELS = 30.0
"""... and so is one that fewer voxels than this face."""
STEPS_VOXELS = (np.arange(-4, 5) / 2, np.arange(-5, 6) / 20)
"""Places to try, from rough to fine: these reach as far as the rough ones are apart ..."""
ROUGH_SAMPLES = 1000
"""... and for the rough ones so many voxels are enough."""
GAIN_SAMPLES, MUCH_GAINED = 400, 1.3
"""A pose gains much if so many voxels make it this many times as good."""
FREE_STEPS_VOXELS = np.array([-3.0, 0.0, 3.0])
"""A pose that the judge likes as well this far to either side is free."""
MIN_DROP = 0.1
"""Share of its score that a pose must lose there to count as held ..."""
MIN_CLOSE_DROP = 0.3
"""... or of what the closer look says, which is stricter about ends and borders, too ..."""
MIN_DECISIVE = 0.5
"""... or what tells the places apart must speak for it as clearly as this."""
ON_ITSELF_SUPPORT, ON_ITSELF_HELD_VOXELS = 0.6, 10.0
"""So much of a tank, a bowl or a table lies on itself however it is turned, so little holds it."""
_PLATEAU = 0.99
"""Scores that are this near to the best one are equal to it, up to sampling."""


def holds(information: FloatArray, matched: int) -> tuple[FloatArray, FloatArray]:
    """How firmly the matched normals hold the translation, along its three principal directions.

    Args:
        information: (6, 6) normal matrix of (rotation, translation).
        matched: correspondences that it sums over.

    Returns:
        (3,) shares of the matches that face each direction, ascending (they sum to 1; all 0 without
        matches), and (3, 3) the unit directions in rows.
    """
    held = information[3:, 3:]
    trace = np.trace(held)
    if matched == 0 or trace <= 0:
        return np.zeros(3), np.eye(3)
    share, vectors = np.linalg.eigh(held / trace)
    return np.clip(share, 0.0, 1.0), vectors.T


def is_weak(share: FloatArray, matched: int) -> BoolArray:
    """Which directions, of these shares of the matches, the normals hold weakly or not at all."""
    return (share < MIN_DETERMINED) | (share * matched < MIN_DETERMINING_VOXELS)


def holds_against(
    information: FloatArray, matched: int, spread_m: float
) -> tuple[FloatArray, FloatArray]:
    """How firmly the matched normals hold a pose against any small motion, turns included.

    A ball that lies on a ball may turn about its middle: no direction in space is free, and yet the
    pose is not fixed.

    Args:
        information: (6, 6) normal matrix of (rotation about the matched points' centre,
            translation).
        matched: correspondences that it sums over.
        spread_m: root mean square of the matched points' distances from their centre.

    Returns:
        (6,) shares of the matches that hold each motion, ascending, as those of ``holds``, and
        (6, 6) the motions in rows: rotation in radians and translation in metres for about each
        metre that the matched points move.
    """
    weight = np.trace(information[3:, 3:])
    if matched == 0 or weight <= 0 or spread_m <= 0:
        return np.zeros(6), np.eye(6)
    per_lever = np.repeat([1 / spread_m, 1.0], 3)
    share, motions = np.linalg.eigh(information * np.outer(per_lever, per_lever) / weight)
    return np.clip(share, 0.0, 1.0), motions.T * per_lever


def weak_motions(
    information: FloatArray, matched: int, spread_m: float, may_turn: bool
) -> FloatArray:
    """(M, 6) motions, as those of ``holds_against``, along which it is worth to look for a better
    place: the directions that few normals face; if there are none, and the pose may turn, the
    motion that is held least, if few hold it.
    """
    share, directions = holds(information, matched)
    weak = directions[is_weak(share, matched)]
    if len(weak) or not may_turn:
        return np.hstack([np.zeros_like(weak), weak])
    share, motions = holds_against(information, matched, spread_m)
    return motions[:1][is_weak(share[:1], matched)]


def lies_on_itself(support: float, held_voxels: float) -> bool:
    """Whether nearly all agrees and yet small things alone hold a pose: it would agree in others as
    well."""
    return support >= ON_ITSELF_SUPPORT and held_voxels <= ON_ITSELF_HELD_VOXELS


def slide(
    T_target_source: FloatArray, motion: FloatArray, centre_m: FloatArray, judge: Judge
) -> FloatArray:
    """Move a pose along one motion to the middle of where the judge likes it best.

    Args:
        T_target_source: (4, 4) pose.
        motion: (6,) rotation about the centre and translation, per metre of motion, target frame.
        centre_m: (3,) target frame.
        judge: of both scans.
    """
    rough = replace(judge, samples=min(judge.samples, ROUGH_SAMPLES))
    for steps_voxels, asked in zip(STEPS_VOXELS, (rough, judge), strict=True):
        moved = _moved(T_target_source, motion, centre_m, steps_voxels * judge.voxel_size_m)
        total = asked.score(moved).total
        good = np.flatnonzero(total >= _PLATEAU * total.max())
        step_m = steps_voxels[good].mean() * judge.voxel_size_m
        T_target_source = _moved(T_target_source, motion, centre_m, step_m[None])[0]
    return T_target_source


def gains_much(
    T_target_source: FloatArray, motion: FloatArray, centre_m: FloatArray, judge: Judge
) -> bool:
    """Whether the judge, asked about few voxels, likes a pose far better somewhere along a motion;
    see ``slide``."""
    few = replace(judge, samples=GAIN_SAMPLES)
    steps_m = STEPS_VOXELS[0] * judge.voxel_size_m
    total = few.score(_moved(T_target_source, motion, centre_m, steps_m)).total
    return bool(total.max() > MUCH_GAINED * total[STEPS_VOXELS[0] == 0].max())


def moves_freely(
    motion: FloatArray, T_target_source: FloatArray, centre_m: FloatArray, judge: Judge
) -> bool:
    """Whether the judge does not mind a pose being moved a little, to and fro.

    Args:
        motion: (6,) rotation about the centre and translation, per metre of motion, target frame.
        T_target_source: (4, 4) pose.
        centre_m: (3,) target frame.
        judge: of both scans.
    """
    steps_m = FREE_STEPS_VOXELS * judge.voxel_size_m
    moved = _moved(T_target_source, motion, centre_m, steps_m)
    score = judge.score(moved)
    sides = np.flatnonzero(FREE_STEPS_VOXELS != 0)
    as_good = sides[score.total[sides] > (1 - MIN_DROP) * score.total[1]]
    if len(as_good) == 0:
        return False
    # By what tells the places apart, though it be little of all that is seen ...
    decisive = judge.decisiveness(moved[1], moved[as_good], is_motion=True)
    as_good = as_good[decisive < MIN_DECISIVE]
    if len(as_good) == 0:
        return False
    # ... and on gentle ground half a voxel is much: what is as good must be so closely, too.
    closer = judge.closer(moved, score).total
    return bool((closer[as_good] > (1 - MIN_CLOSE_DROP) * closer[1]).any())


def _moved(
    T_target_source: FloatArray, motion: FloatArray, centre_m: FloatArray, steps_m: FloatArray
) -> FloatArray:
    """(K, 4, 4) the pose moved by each of (K,) steps along a motion about the centre."""
    turns = np.stack([rotation_from_vector(step_m * motion[:3]) for step_m in steps_m])
    shifts_m = centre_m - turns @ centre_m + steps_m[:, None] * motion[3:]
    moved: FloatArray = make_transform(turns, shifts_m) @ T_target_source
    return moved
