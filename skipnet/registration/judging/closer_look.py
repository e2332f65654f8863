"""A closer look at rivals: how near do the surfaces really come that count as agreeing?

The judge lets surfaces agree that are half a voxel apart, because a scan may be as noisy as that.
On smooth shapes, rolling ground or a figure's skin, wrong poses thrive on it: much agrees roughly,
little exactly. Under the right pose all that agrees is as near as noise allows. So where the race
is close, the tolerance is halved as long as some candidate keeps what it had; only voxels that know
their place better than the tolerance have a say.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.registration.judging.judge import FINE, Score, judge
from skipnet.scans.evidence import Evidence
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray

TOLERANCES_VOXELS = (0.25, 0.125, 0.0625)
"""To try in this order; ``FINE`` has 0.5."""
SURE_SHARE = 1 / 6
"""A voxel has a say when its centroid's error is below this share of the tolerance."""
MIN_SURE = 0.1
"""A tolerance needs this share of each scan's voxels that have a say."""
MIN_KEPT = 0.8
"""A tolerance is below the scans' noise when every candidate loses more of its overlap to it."""
MIN_STANDING = 0.3
"""Only candidates with this share of the best score say what the noise allows."""
_UNSURE_WEIGHT = 1e-6
"""Where no voxel that has a say agrees, the others tell."""


def look_closer(
    T_target_source: FloatArray,
    score: Score,
    scans: tuple[tuple[Evidence, SkipMap], tuple[Evidence, SkipMap]],
    samples: int,
    violation_weight: float,
) -> Score:
    """Score poses again with the least tolerance that the scans' noise allows.

    Args:
        T_target_source: (C, 4, 4) poses after fine alignment, C >= 1.
        score: what ``judge`` said of them with ``FINE``.
        scans: evidence and Skip-map of the source and of the target.
        samples: as in ``judge``.
        violation_weight: as in ``judge``.

    Returns:
        The same overlap and violation, and totals that order the poses anew: each counts as far as
        its agreement is close, and the best has the total that it had.
    """
    standing = score.total >= MIN_STANDING * score.total.max()
    errors_voxels = [centroid_errors_voxels(skipmap) for _, skipmap in scans]
    total = score.total
    for tolerance_voxels in TOLERANCES_VOXELS:
        sure = [error < SURE_SHARE * tolerance_voxels for error in errors_voxels]
        if min(one.mean() for one in sure) < MIN_SURE:
            break
        source, target = (
            evidence.weighing(one + _UNSURE_WEIGHT)
            for (evidence, _), one in zip(scans, sure, strict=True)
        )
        loose, strict = (
            judge(T_target_source, source, target, samples, violation_weight, limit)
            for limit in (FINE, replace(FINE, max_distance_voxels=tolerance_voxels))
        )
        kept = strict.overlap / np.maximum(loose.overlap, 1e-9)
        if kept[standing].max() < MIN_KEPT:
            break
        # Once for what no longer agrees, once more for what this says about the rest.
        total = score.total * kept**2
    best = total.argmax()
    return replace(score, total=total * (score.total[best] / max(total[best], 1e-9)))


def centroid_errors_voxels(skipmap: SkipMap) -> FloatArray:
    """(V,) standard deviation of each voxel's centroid along its normal, in voxels."""
    deviation_m = np.sqrt(skipmap.eigenvalues_m2[:, 0] / skipmap.counts)
    return deviation_m / skipmap.voxel_size_m
