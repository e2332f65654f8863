"""Directions in which few normals hold a pose: the judge finds the place, or finds that none is.

Two rooms through a doorway touch in the door's frame alone. Hardly any surface there faces along
the wall, yet what each sensor saw past the frame tells where the other room must be. In a corridor
nothing does.
"""

from __future__ import annotations

import numpy as np

from skipnet.registration.verification import FINE, Evidence, judge
from skipnet.types import FloatArray

STEPS_VOXELS = (np.arange(-8, 9) / 4, np.arange(-5, 6) / 20)
"""Places to try, from rough to fine."""
FREE_STEPS_VOXELS = np.array([-3.0, 0.0, 3.0])
"""A pose that the judge likes as well this far to either side is free."""
MIN_DROP = 0.1
"""Share of its score that a pose must lose there to count as held."""
_PLATEAU = 0.99
"""Scores that are this near to the best one are equal to it, up to sampling."""


def slide(
    T_target_source: FloatArray,
    direction: FloatArray,
    source: Evidence,
    target: Evidence,
    samples: int,
    violation_weight: float,
) -> FloatArray:
    """Move a pose along one direction to the middle of where the judge likes it best.

    Args:
        T_target_source: (4, 4) pose.
        direction: (3,) unit vector, target frame.
        source: the source's evidence.
        target: the target's evidence.
        samples: as in ``judge``.
        violation_weight: as in ``judge``.
    """
    for steps_voxels in STEPS_VOXELS:
        moved = _moved(T_target_source, direction, steps_voxels * target.voxel_size_m)
        total = judge(moved, source, target, samples, violation_weight, FINE).total
        good = np.flatnonzero(total >= _PLATEAU * total.max())
        step_m = steps_voxels[good].mean() * target.voxel_size_m
        T_target_source = _moved(T_target_source, direction, step_m[None])[0]
    return T_target_source


def slides_freely(
    T_target_source: FloatArray,
    direction: FloatArray,
    source: Evidence,
    target: Evidence,
    samples: int,
    violation_weight: float,
) -> bool:
    """Whether the judge does not mind a pose being moved along a direction; arguments as above."""
    moved = _moved(T_target_source, direction, FREE_STEPS_VOXELS * target.voxel_size_m)
    total = judge(moved, source, target, samples, violation_weight, FINE).total
    return bool(total.max(initial=0.0, where=FREE_STEPS_VOXELS != 0) > (1 - MIN_DROP) * total[1])


def _moved(T_target_source: FloatArray, direction: FloatArray, steps_m: FloatArray) -> FloatArray:
    """(K, 4, 4) the pose moved by each of (K,) steps along the direction."""
    moved = np.repeat(T_target_source[None], len(steps_m), axis=0)
    moved[:, :3, 3] += steps_m[:, None] * direction
    return moved
