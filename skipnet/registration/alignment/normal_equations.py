"""One step of fine alignment: correspondences by lookup, and the normal equations they make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

MODEL_ERROR_VOXELS = 0.002
"""How far a real surface departs from its voxel's plane at best, so that dense voxels do not
decide all."""
_MEDIAN_SAMPLES = 4096
"""So many residuals tell their typical size to one or two per cent."""


@dataclass(frozen=True)
class Matches:
    """What one step's correspondences of C candidates come to, linearised; see
    ``skipnet.registration.alignment.refinement.Refinement``."""

    matched: IntArray
    """(C,)."""
    centre_m: FloatArray
    """(C, 3) target frame."""
    spread_m: FloatArray
    """(C,)."""
    information: FloatArray
    """(C, 6, 6) left side of the normal equations ..."""
    gradient: FloatArray
    """(C, 6) ... and the right one: what a small motion should be, times the information."""

    @staticmethod
    def none(matched: IntArray) -> Matches:
        """Zeros for (C,) numbers of correspondences, to be added up in."""
        count = len(matched)
        centre_m, information = np.zeros((count, 3)), np.zeros((count, 6, 6))
        return Matches(matched, centre_m, np.zeros(count), information, np.zeros((count, 6)))


_Arrays = tuple[FloatArray, FloatArray, FloatArray]
"""The first three fields of ``Surfaces``."""


@dataclass(frozen=True)
class Surfaces:
    """Voxels of one scan."""

    centroids_m: FloatArray
    """(V, 3)."""
    normals: FloatArray
    """(V, 3)."""
    variance_m2: FloatArray
    """(V,) of each centroid along its normal: scatter across the surface over points."""
    oriented: bool

    @staticmethod
    def of(skipmap: SkipMap, rows: IntArray | slice) -> Surfaces:
        """Some voxels of a Skip-map."""
        floor_m = MODEL_ERROR_VOXELS * skipmap.voxel_size_m
        across_m2 = skipmap.eigenvalues_m2[rows, 0]
        return Surfaces(
            skipmap.centroids_m[rows],
            skipmap.normals[rows],
            across_m2 / skipmap.counts[rows] + floor_m**2,
            skipmap.viewpoint_m is not None,
        )


def match_surfaces(
    T: FloatArray,
    source: Surfaces,
    target: Surfaces,
    table: CellTable,
    min_normal_cosine: float,
) -> Matches:
    """Correspondences by lookup, and the normal equations of their residuals.

    Args:
        T: (C, 4, 4) poses of the source in the target's frame.
        source: voxels to match.
        target: voxels to match them with.
        table: the target voxel in each cell.
        min_normal_cosine: smallest cosine between matching normals.
    """
    count = len(source.centroids_m)
    pairs, matched = np.empty((len(T), count, 8)), np.zeros(len(T), np.int64)
    residuals_m = np.empty((len(T), count))
    _pair_up_all(
        T,
        (source.centroids_m, source.normals, source.variance_m2),
        (target.centroids_m, target.normals, target.variance_m2),
        table.find_moved(T, source.centroids_m),
        source.oriented and target.oriented,
        min_normal_cosine,
        pairs,
        residuals_m,
        matched,
    )
    typical_m2 = np.array(
        [_typical_m2(own[:count]) for own, count in zip(residuals_m, matched, strict=True)]
    )
    found = Matches.none(matched)
    _sum_up_all(
        pairs,
        matched,
        typical_m2,
        (found.centre_m, found.spread_m, found.information, found.gradient),
    )
    return found


def _typical_m2(residuals_m: FloatArray) -> float:
    """Square of the median of (K,) sizes of residuals, which come into another order."""
    if len(residuals_m) == 0:
        return 0.0
    some_m = residuals_m[:: 1 + len(residuals_m) // _MEDIAN_SAMPLES]
    middle = len(some_m) // 2
    some_m.partition(middle)
    return float(some_m[middle]) ** 2


@compiled
def _pair_up_all(
    T_target_source: FloatArray,
    source: _Arrays,
    target: _Arrays,
    row: IntArray,
    oriented: bool,
    min_normal_cosine: float,
    pairs: FloatArray,
    residuals_m: FloatArray,
    matched: IntArray,
) -> None:
    """``_pair_up`` for (C, 4, 4) poses, into (C, S, 8) ``pairs`` and (C,) ``matched``, with the
    sizes of their (C, S) residuals."""
    for c in range(len(row)):
        matched[c] = _pair_up(
            T_target_source[c], source, target, row[c], oriented, min_normal_cosine, pairs[c]
        )
        for k in range(matched[c]):
            residuals_m[c, k] = abs(pairs[c, k, 6])


@compiled
def _sum_up_all(
    pairs: FloatArray,
    matched: IntArray,
    typical_m2: FloatArray,
    figures: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Centre, spread, information and gradient of C candidates: robustly weighted normal equations
    (Geman-McClure) of the residuals along the mean of both normals, about the matched points'
    centre, into zeros."""
    centre_m, spread_m, information, gradient = figures
    for c in range(len(pairs)):
        count = matched[c]
        if count == 0:
            continue
        for k in range(count):
            for i in range(3):
                centre_m[c, i] += pairs[c, k, i]
        for i in range(3):
            centre_m[c, i] /= count
        square_m2 = _sum_up(
            pairs[c, :count], centre_m[c], typical_m2[c], information[c], gradient[c]
        )
        spread_m[c] = np.sqrt(square_m2 / count)


@compiled
def _pair_up(
    T_target_source: FloatArray,
    source: _Arrays,
    target: _Arrays,
    row: IntArray,
    oriented: bool,
    min_normal_cosine: float,
    pairs: FloatArray,
) -> int:
    """Of (S,) correspondences those whose normals agree, into (S, 8) ``pairs``: the source's point
    where the pose puts it, the mean normal, the residual along it and its variance; and how many.
    """
    source_m, source_normals, source_variance_m2 = source
    target_m, target_normals, target_variance_m2 = target
    T, count = T_target_source, 0
    for s in range(len(row)):
        t = row[s]
        if t < 0:
            continue
        cosine = 0.0
        for i in range(3):
            pairs[count, i], pairs[count, 3 + i] = T[i, 3], 0.0
            for j in range(3):
                pairs[count, i] += T[i, j] * source_m[s, j]
                pairs[count, 3 + i] += T[i, j] * source_normals[s, j]
            cosine += pairs[count, 3 + i] * target_normals[t, i]
        side = -1.0 if cosine < 0 and not oriented else 1.0
        if not side * cosine > min_normal_cosine:
            continue
        length = np.sqrt(2 + 2 * side * cosine)  # of the sum of two unit normals
        residual_m = 0.0
        for i in range(3):
            normal = (side * pairs[count, 3 + i] + target_normals[t, i]) / length
            pairs[count, 3 + i] = normal
            residual_m += normal * (target_m[t, i] - pairs[count, i])
        pairs[count, 6] = residual_m
        pairs[count, 7] = source_variance_m2[s] + target_variance_m2[t]
        count += 1
    return count


@compiled
def _sum_up(
    pairs: FloatArray,
    centre_m: FloatArray,
    typical_m2: float,
    information: FloatArray,
    gradient: FloatArray,
) -> float:
    """The normal equations of (K, 8) pairs, added to (6, 6) and (6,) zeros; and the sum of the
    squared distances from the centre."""
    jacobian = np.empty(6)
    square_m2 = 0.0
    for k in range(len(pairs)):
        residual_m, variance_m2 = pairs[k, 6], pairs[k, 7]
        scale_m2 = 16 * typical_m2 + variance_m2
        robust = scale_m2 / (scale_m2 + residual_m * residual_m)
        weight = robust * robust / (variance_m2 + typical_m2)
        x, y = pairs[k, 0] - centre_m[0], pairs[k, 1] - centre_m[1]
        z = pairs[k, 2] - centre_m[2]
        square_m2 += x * x + y * y + z * z
        n_x, n_y, n_z = pairs[k, 3], pairs[k, 4], pairs[k, 5]
        jacobian[0], jacobian[1] = y * n_z - z * n_y, z * n_x - x * n_z
        jacobian[2], jacobian[3] = x * n_y - y * n_x, n_x
        jacobian[4], jacobian[5] = n_y, n_z
        for i in range(6):
            weighted = weight * jacobian[i]
            gradient[i] += weighted * residual_m
            for j in range(i + 1):
                information[i, j] += weighted * jacobian[j]
    for i in range(6):
        for j in range(i):
            information[j, i] = information[i, j]
    return square_m2
