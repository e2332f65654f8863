"""Alike is not equal: what agrees roughly everywhere, exactly in most places, not so in some.

Under a right pose all that agrees lies as near as the scans' errors let it, large or small. Another
specimen of a kind, or a mirror image, fits exactly where it is the same, and elsewhere lies off by
many times as much, though it be within the judge's tolerance.
"""

from __future__ import annotations

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.scans.evidence import CLEAR_CURVATURE
from skipnet.scans.scan import Scan
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray

SAMPLES = 6000
FLOOR_VOXELS = 0.02
"""How far a real surface departs from its voxel's plane, whatever its points say."""
MIN_COSINE = 0.8
FARTHEST_VOXELS = 1.5
"""What lies farther off is another surface."""
USUAL_ERROR = 0.67
"""Median of what is due to noise alone, in its standard deviations."""
ODD_TIMES = 7.5
"""What lies off by so many times as much as half of all, or as half of all would, is odd."""
FEW = 50
"""Fewer surfaces say nothing."""


def odd_share(T_target_source: FloatArray, source: Scan, target: Scan) -> float:
    """Share of what agrees under a (4, 4) pose that lies off by far more than the rest.

    The less of both ways: the far side of a thin wall is odd to the one that has both sides only.

    Args:
        T_target_source: the pose, finely aligned.
        source: its finest level is looked at.
        target: likewise.
    """
    there = _one_way(T_target_source, source, target)
    return min(there, _one_way(invert(T_target_source), target, source))


def _one_way(T_b_a: FloatArray, scan_a: Scan, scan_b: Scan) -> float:
    a, b = scan_a.fine_skipmap, scan_b.fine_skipmap
    clear = np.flatnonzero(a.curvatures < CLEAR_CURVATURE)
    rows_a = clear[np.linspace(0, len(clear) - 1, min(SAMPLES, len(clear))).astype(np.int64)]
    if min(len(rows_a), len(b)) == 0:
        return 0.0
    rows_b = scan_b.fine_near.find_moved(T_b_a[None], a.centroids_m[rows_a])[0]
    found = (rows_b >= 0) & (b.curvatures[rows_b] < CLEAR_CURVATURE)
    rows_a, rows_b = rows_a[found], rows_b[found]
    moved_m = transform_points(T_b_a, a.centroids_m[rows_a])
    normals = b.normals[rows_b]
    off_m = np.abs(np.einsum("vi,vi->v", normals, moved_m - b.centroids_m[rows_b]))
    cosine = np.einsum("vi,vi->v", a.normals[rows_a] @ T_b_a[:3, :3].T, normals)
    oriented = a.viewpoint_m is not None and b.viewpoint_m is not None
    agree = (cosine if oriented else np.abs(cosine)) > MIN_COSINE
    agree &= off_m < FARTHEST_VOXELS * b.voxel_size_m
    if agree.sum() < FEW:
        return 0.0
    variance_m2 = _variance_m2(a, rows_a[agree]) + _variance_m2(b, rows_b[agree])
    errors = off_m[agree] / np.sqrt(variance_m2)
    limit = ODD_TIMES * max(float(np.median(errors)), USUAL_ERROR)
    return float((errors > limit).mean())


def _variance_m2(skipmap: SkipMap, rows: FloatArray) -> FloatArray:
    """(K,) of the voxels' centroids along their normals."""
    across_m2 = skipmap.eigenvalues_m2[rows, 0] / skipmap.counts[rows]
    variance: FloatArray = across_m2 + 0.5 * (FLOOR_VOXELS * skipmap.voxel_size_m) ** 2
    return variance
