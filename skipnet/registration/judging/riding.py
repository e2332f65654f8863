"""What rides with the sensor: the own car, the operator, the mast, and rings on flat ground.

It looks the same in every scan, wherever the sensor has gone, and so speaks for a pose that leaves
the sensor where it was. What lies near both sensors, at the same place in both scans' own frames,
has no say. And where two sensors would have stood at one place, they would have seen the same: if
much of what stands farther off is not there again, nothing but rings and bodies speaks for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import FINE
from skipnet.registration.judging.states import matches
from skipnet.scans.evidence import Evidence
from skipnet.types import BoolArray, FloatArray

MIN_TRUST = 0.5
"""Of either viewpoint: nothing rides with a sensor that was not there."""
NEAR_SHARE = 0.3
"""A body rides within this share of the range that all but the farthest of a scan lies in."""
_FARTHEST = 0.95
MIN_RIDING = 20.0
"""Worth, in voxels, of a body that could decide."""
SAME_PLACE_VOXELS = 2.0
"""Sensors nearer to each other stand at one place."""
MIN_SEEN_AGAIN = 0.92
"""Of what one place shows twice; of stationary simulated sensors at least 0.94 matches, of moving
ones, brought to one place, at most 0.9."""
_STANDS_OUT = 0.5
"""What is worth less is part of a large plane."""
_NO_SAY = 1e-6


def silence_riders(judge: Judge, T_same_axes: FloatArray) -> Judge:
    """The judge without what lies near both sensors at the same place of their frames.

    Args:
        judge: of two scans.
        T_same_axes: (4, 4) the pose that lays the frames in which the scans were given on each
            other.

    Returns:
        The same judge where a viewpoint is not to be trusted.
    """
    if min(judge.source.trust, judge.target.trust) < MIN_TRUST:
        return judge
    shares, worth = [], 0.0
    for T, a, b in _both_ways(T_same_axes, judge):
        match, _ = matches(T[None], a, b, len(a.points_m), FINE)
        riding = (match[0] > 0.5) & ~_is_far(a)
        worth += float(a.weights[riding].sum())
        share = np.ones(len(riding))
        share[a.order[riding]] = _NO_SAY
        shares.append(share)
    source, target = judge.source.weighing(shares[0]), judge.target.weighing(shares[1])
    return replace(judge, source=source, target=target, riding_worth=worth / 2)


def seen_again(judge: Judge, T_target_source: FloatArray) -> float:
    """Of what stands out afar in either scan, the share that the other one has under a (4, 4) pose.

    Returns:
        0 to 1; 1 where the pose leaves the sensors at different places, or nothing stands out.
    """
    source, target = judge.source.range_image, judge.target.range_image
    trust = min(judge.source.trust, judge.target.trust)
    if source is None or target is None or trust < MIN_TRUST:
        return 1.0
    there_m = transform_points(T_target_source, source.viewpoint_m[None])[0]
    if np.linalg.norm(there_m - target.viewpoint_m) > SAME_PLACE_VOXELS * judge.voxel_size_m:
        return 1.0
    shares = []
    for T, a, b in _both_ways(T_target_source, judge):
        assert b.range_image is not None
        match, _ = matches(T[None], a, b, len(a.points_m), FINE)
        asked = _is_far(a) & (a.weights > _STANDS_OUT)
        asked &= b.range_image.sees(T, a.points_m)
        if asked.any():
            shares.append(float(match[0][asked].mean()))
    return float(np.mean(shares)) if shares else 1.0


def _both_ways(T: FloatArray, judge: Judge) -> list[tuple[FloatArray, Evidence, Evidence]]:
    return [(T, judge.source, judge.target), (invert(T), judge.target, judge.source)]


def _is_far(a: Evidence) -> BoolArray:
    """(V,) which voxels are too far from the sensor to ride with it."""
    assert a.range_image is not None
    range_m = np.linalg.norm(a.points_m - a.range_image.viewpoint_m, axis=1)
    far: BoolArray = range_m > NEAR_SHARE * np.quantile(range_m, _FARTHEST)
    return far
