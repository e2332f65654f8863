"""A closer look at rivals: how near do the surfaces really come that count as agreeing?

The judge lets surfaces agree that are half a voxel apart, because a scan may be as noisy as that.
On smooth shapes, rolling ground or a figure's skin, wrong poses thrive on it: much agrees roughly,
little exactly. Under the right pose all that agrees is as near as noise allows. So where the race
is close, the tolerance is halved as long as some candidate keeps what it had, and enough voxels
know their place better than it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from skipnet.registration.judging.score import FINE, Score
from skipnet.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from skipnet.registration.judging.judge import Judge

TOLERANCES_VOXELS = (0.25, 0.125, 0.0625)
"""To try in this order; ``FINE`` has 0.5."""
SURE_SHARE = 1 / 6
"""A voxel is sure of its place when its centroid's error is below this share of the tolerance."""
MIN_SURE = 0.1
"""A tolerance needs this share of each scan's voxels that are sure."""
MIN_KEPT = 0.8
"""A tolerance is below the scans' noise when every candidate loses more of its overlap to it."""
MIN_STANDING = 0.3
"""Only candidates with this share of the best score say what the noise allows."""

_UNSURE_WEIGHT = 1e-6
"""Where no voxel that has a say agrees, the others tell."""


def look_closer(judge: Judge, T_target_source: FloatArray, score: Score) -> Score:
    """Score poses again with the least tolerance that the scans' noise allows.

    Args:
        judge: of both scans.
        T_target_source: (C, 4, 4) poses after fine alignment, C >= 1.
        score: what the judge said of them with ``FINE``.

    Returns:
        The same overlap and violation, and totals that order the poses anew: each counts as far as
        its agreement is close, and the best has the total that it had.
    """
    standing = score.total >= MIN_STANDING * score.total.max()
    total = score.total
    ways = (replace(FINE, max_distance_voxels=voxels) for voxels in TOLERANCES_VOXELS)
    overlaps = judge.overlaps(T_target_source, ways)
    for tolerance_voxels in TOLERANCES_VOXELS:
        if _sure(judge, tolerance_voxels) is None:
            break
        kept = next(overlaps) / np.maximum(score.overlap, 1e-9)
        if kept[standing].max() < MIN_KEPT:
            break
        # Once for what no longer agrees, once more for what this says about the rest.
        total = score.total * kept**2
    best = total.argmax()
    return replace(score, total=total * (score.total[best] / max(total[best], 1e-9)))


def closeness(judge: Judge, T_target_source: FloatArray) -> float:
    """Share of what agrees under a (4, 4) pose that does so twice as closely, by its worth; 1 where
    too few voxels know their place so exactly."""
    tolerance_voxels = TOLERANCES_VOXELS[0]
    sure = _sure(judge, tolerance_voxels)
    if sure is None:
        return 1.0
    source, target = (
        scan.weighing(one + _UNSURE_WEIGHT)
        for scan, one in zip((judge.source, judge.target), sure, strict=True)
    )
    surely = replace(judge, source=source, target=target)
    strict = replace(FINE, max_distance_voxels=tolerance_voxels)
    loose_support, strict_support = (
        float(surely.score(T_target_source[None], limit).support[0]) for limit in (FINE, strict)
    )
    return strict_support / max(loose_support, 1e-9)


def _sure(judge: Judge, tolerance_voxels: float) -> list[BoolArray] | None:
    """Of each scan which voxels know their place so exactly; None where these are too few."""
    sure = [
        scan.centroid_errors_voxels < SURE_SHARE * tolerance_voxels
        for scan in (judge.source, judge.target)
    ]
    return sure if min(one.mean() for one in sure) >= MIN_SURE else None
