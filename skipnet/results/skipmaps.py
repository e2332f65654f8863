"""The Skip-maps of a pair as its page shows them, and which feature voxels correspond."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.geometry import nearest, transform_points
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.registration.result import Registration
from skipnet.scans.scan import Scan
from skipnet.types import FeatureClass
from skipnet.viz.viewed import NO_CLASS, ViewedSkipMap

_REACH_VOXELS = 1.5
_MOST_MATCHES = 300


@one_blas_thread
def skipmaps_of(result: Registration) -> tuple[ViewedSkipMap | None, ViewedSkipMap | None]:
    """Of source and target, in the frames that they were given in; None where not kept."""
    if result.given is None or result.given.described is None:
        return None, None
    source, target = side_by_side(viewed_skipmap, result.given.described)
    return source, target


def viewed_skipmap(scan: Scan) -> ViewedSkipMap:
    """Of one scan, in the frame that it was given in."""
    classes = np.full(len(scan.skipmap), NO_CLASS)
    classes[scan.features.rows] = scan.features.classes
    centroids_m = transform_points(scan.T_given_own, scan.skipmap.centroids_m)
    return ViewedSkipMap(centroids_m, scan.skipmap.curvatures, classes)


def matched_features(
    skipmaps: Sequence[ViewedSkipMap | None], result: Registration
) -> list[tuple[int, int]]:
    """Corners and edges of one class that come to lie at one place in the result's pose.

    Returns:
        Numbers of the source's and of the target's feature voxels other than planes.
    """
    source, target = skipmaps
    if source is None or target is None or result.findings is None:
        return []
    rows = [np.flatnonzero(one.classes < FeatureClass.PLANE) for one in (source, target)]
    if not len(rows[0]) or not len(rows[1]):
        return []
    moved_m = transform_points(result.T_target_source, source.centroids_m[rows[0]])
    away_m, partner = nearest(moved_m, target.centroids_m[rows[1]])
    alike = source.classes[rows[0]] == target.classes[rows[1]][partner]
    found = np.flatnonzero(alike & (away_m < _REACH_VOXELS * result.voxel_size_m))
    kept = np.random.default_rng(0).permutation(found)[:_MOST_MATCHES]
    return [(int(row), int(partner[row])) for row in kept]
