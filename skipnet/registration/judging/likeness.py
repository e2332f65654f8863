"""Alike is not equal: what agrees roughly everywhere, exactly in most places, not so in some.

Under a right pose all that agrees lies as near as the scans' errors let it, large or small. Another
specimen of a kind, or a mirror image, fits exactly where it is the same, and elsewhere lies off by
many times as much, though it be within the judge's tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.scans.evidence import CLEAR_CURVATURE
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, IntArray

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
    there = _odd(_agreeing(T_target_source, source, target))
    return min(there, _odd(_agreeing(invert(T_target_source), target, source)))


def typical_offset(T_target_source: FloatArray, source: Scan, target: Scan) -> float:
    """How far off half of what agrees under a (4, 4) pose lies at least, in standard deviations of
    the points about their surfaces, or of their lattice; the less of both ways.

    What is a little larger than the other fits roughly everywhere and exactly nowhere.
    """
    ways = (T_target_source, source, target), (invert(T_target_source), target, source)
    step_m = max(source.lattice_step_m, target.lattice_step_m)
    return min(_offset(_agreeing(*way), step_m) for way in ways)


def _odd(agreeing: _Agreeing) -> float:
    variance_m2 = sum(across / counts for across, counts in agreeing.scatter)
    errors = agreeing.off_m / np.sqrt(variance_m2 + agreeing.floor_m2)
    if len(errors) < FEW:
        return 0.0
    limit = ODD_TIMES * max(float(np.median(errors)), USUAL_ERROR)
    return float((errors > limit).mean())


def _offset(agreeing: _Agreeing, step_m: float) -> float:
    variance_m2 = sum(across for across, _ in agreeing.scatter)
    errors = agreeing.off_m / np.sqrt(variance_m2 + agreeing.floor_m2 + step_m**2 / 6)
    return 0.0 if len(errors) < FEW else float(np.median(errors))


@dataclass(frozen=True)
class _Agreeing:
    """Pairs of voxels, one of either scan, that agree."""

    off_m: FloatArray
    """(K,) how far they lie off each other's plane."""
    scatter: tuple[tuple[FloatArray, IntArray], ...]
    """Of either scan (K,) its points' variance across the surface (m^2), and how many they are."""
    floor_m2: float
    """Variance that any voxel of a real surface has."""


def _agreeing(T_b_a: FloatArray, scan_a: Scan, scan_b: Scan) -> _Agreeing:
    a, b = scan_a.fine_skipmap, scan_b.fine_skipmap
    clear = np.flatnonzero(a.curvatures < CLEAR_CURVATURE)
    rows_a = clear[np.linspace(0, len(clear) - 1, min(SAMPLES, len(clear))).astype(np.int64)]
    rows_b = scan_b.fine_near.find_moved(T_b_a[None], a.centroids_m[rows_a])[0]
    found = rows_b >= 0
    found[found] = b.curvatures[rows_b[found]] < CLEAR_CURVATURE
    rows_a, rows_b = rows_a[found], rows_b[found]
    moved_m = transform_points(T_b_a, a.centroids_m[rows_a])
    normals = b.normals[rows_b]
    off_m = np.abs(np.einsum("vi,vi->v", normals, moved_m - b.centroids_m[rows_b]))
    cosine = np.einsum("vi,vi->v", a.normals[rows_a] @ T_b_a[:3, :3].T, normals)
    oriented = a.viewpoint_m is not None and b.viewpoint_m is not None
    agree = (cosine if oriented else np.abs(cosine)) > MIN_COSINE
    agree &= off_m < FARTHEST_VOXELS * b.voxel_size_m
    scatter = (
        (one.eigenvalues_m2[rows[agree], 0], one.counts[rows[agree]])
        for one, rows in ((a, rows_a), (b, rows_b))
    )
    floors = (0.5 * (FLOOR_VOXELS * one.voxel_size_m) ** 2 for one in (a, b))
    return _Agreeing(off_m[agree], tuple(scatter), sum(floors))
