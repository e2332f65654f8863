"""Fine alignment: ICP on Skip-map voxels with oriented normals, from coarse level to fine.

Each source voxel corresponds to the target voxel it falls into, if their normals agree: the two
sides of a wall never match. Residuals are taken along the normals (symmetric point-to-plane) and
weighted by what the voxels' moments say about their own accuracy, so flat, well-filled voxels
decide and rough ones hardly count. A correspondence is one table lookup; no search tree is built.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import invert, make_transform, rotation_from_vector
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

MIN_MATCHES = 50
"""Fewer correspondences at a level say nothing."""
MODEL_ERROR_VOXELS = 0.002
"""How far a real surface departs from its voxel's plane at best, so that dense voxels do not
decide all."""
_MEDIAN_SAMPLES = 4096
"""So many residuals tell their typical size to one or two per cent."""
_FREE = 1e-9
"""Share of the best held direction's information that any direction is granted."""
DAMPING_VOXELS = 1.0
"""Hold, in voxels, with which a pose keeps its place: where the data hold it less, it does not
drift along on noise."""


@dataclass(frozen=True)
class Refinement:
    """Fine poses of C candidates and how well the data determine each."""

    T_target_source: FloatArray
    """(C, 4, 4) float64; the starting pose where no level had enough to hold on to."""
    information: FloatArray
    """(C, 6, 6) inverse covariance of (rotation about the matched points' centre, translation), in
    the target's axes, 1/rad^2 and 1/m^2."""
    matched: IntArray
    """(C,) correspondences in the last step."""
    centre_m: FloatArray
    """(C, 3) centre of the matched points, target frame."""
    spread_m: FloatArray
    """(C,) root mean square of their distances from it."""

    @property
    def covariance(self) -> FloatArray:
        """(C, 6, 6) inverse of ``information``; large but finite where nothing holds the pose."""
        diagonal = np.einsum("cii->ci", self.information)
        loose = _FREE * np.maximum(diagonal, diagonal.max(axis=1, keepdims=True, initial=1e-12))
        return np.linalg.inv(self.information + np.eye(6) * loose[..., None])

    def __getitem__(self, rows: IntArray) -> Refinement:
        """The candidates of some rows."""
        return Refinement(
            self.T_target_source[rows],
            self.information[rows],
            self.matched[rows],
            self.centre_m[rows],
            self.spread_m[rows],
        )


def refine(
    T_target_source: FloatArray,
    levels: list[tuple[SkipMap, SkipMap]],
    samples: int | None = None,
    max_steps: int = 12,
    min_normal_cosine: float = 0.85,
) -> Refinement:
    """Refine candidate poses over levels of the Skip-map, all candidates at once.

    Args:
        T_target_source: (C, 4, 4) starting poses, right to about one voxel of the first level.
        levels: (source, target) Skip-maps, coarse first.
        samples: voxels of the source to use at each level; None uses all.
        max_steps: Gauss-Newton steps at each level; it stops when no pose moves any more.
        min_normal_cosine: smallest cosine between matching normals.
    """
    T: FloatArray = np.array(T_target_source, dtype=np.float64)
    result = _before_any_level(T)
    for source, target in levels:
        if min(len(source), len(target)) == 0:
            continue  # a level without surfaces has no hold
        rows = _spread_rows(len(source), samples)
        surfaces = _Surfaces.of(source, rows), _Surfaces.of(target, slice(None))
        for _ in range(max_steps):
            matches = _match(T, *surfaces, target.table, min_normal_cosine)
            T, moved_m = _gauss_newton_step(T, matches)
            if moved_m < 1e-4 * target.voxel_size_m:
                break
        result = _keep_tracked(result, T, matches, 1.5 * target.voxel_size_m)
        T = result.T_target_source
    return result


def _before_any_level(T: FloatArray) -> Refinement:
    count = len(T)
    matched = np.zeros(count, dtype=np.int64)
    return Refinement(T, np.zeros((count, 6, 6)), matched, np.zeros((count, 3)), np.zeros(count))


def _keep_tracked(
    before: Refinement, T: FloatArray, matches: _Matches, max_shift_m: float
) -> Refinement:
    """Take over a level's poses, but for those that ran away: too sparse a level has no hold."""
    before_m = apply(before.T_target_source, apply(invert(T), matches.centre_m))
    shift_m = np.linalg.norm(matches.centre_m - before_m, axis=1)
    good = (matches.matched >= MIN_MATCHES) & (shift_m < max_shift_m)
    return Refinement(
        np.where(good[:, None, None], T, before.T_target_source),
        np.where(good[:, None, None], matches.information, before.information),
        np.where(good, matches.matched, before.matched),
        np.where(good[:, None], matches.centre_m, before.centre_m),
        np.where(good, matches.spread_m, before.spread_m),
    )


@dataclass(frozen=True)
class _Matches:
    """What one step's correspondences of C candidates come to, linearised; see ``Refinement``."""

    matched: IntArray
    centre_m: FloatArray
    spread_m: FloatArray
    information: FloatArray
    gradient: FloatArray


def apply(T_a_b: FloatArray, point_b_m: FloatArray) -> FloatArray:
    """Map one (C, 3) point by each of (C, 4, 4) transforms."""
    return np.einsum("cij,cj->ci", T_a_b[:, :3, :3], point_b_m) + T_a_b[:, :3, 3]


def _spread_rows(count: int, samples: int | None) -> IntArray | slice:
    """Evenly spread rows; the tree's order walks through space, so they cover the whole scan."""
    if samples is None or samples >= count:
        return slice(None)
    return np.linspace(0, count - 1, samples).astype(np.int64)


@dataclass(frozen=True)
class _Surfaces:
    """Voxels of one scan."""

    centroids_m: FloatArray
    """(V, 3)."""
    normals: FloatArray
    """(V, 3)."""
    variance_m2: FloatArray
    """(V,) of each centroid along its normal: scatter across the surface over points."""
    oriented: bool

    @staticmethod
    def of(skipmap: SkipMap, rows: IntArray | slice) -> _Surfaces:
        """Some voxels of a Skip-map."""
        floor_m = MODEL_ERROR_VOXELS * skipmap.voxel_size_m
        across_m2 = skipmap.eigenvalues_m2[rows, 0]
        return _Surfaces(
            skipmap.centroids_m[rows],
            skipmap.normals[rows],
            across_m2 / skipmap.counts[rows] + floor_m**2,
            skipmap.viewpoint_m is not None,
        )


def _match(
    T: FloatArray,
    source: _Surfaces,
    target: _Surfaces,
    table: CellTable,
    min_normal_cosine: float,
) -> _Matches:
    """Correspondences by lookup, and the normal equations of their residuals."""
    figures = _normal_equations(
        T,
        *(source.centroids_m, source.normals, source.variance_m2),
        *(target.centroids_m, target.normals, target.variance_m2),
        table.find_moved(T, source.centroids_m),
        source.oriented and target.oriented,
        min_normal_cosine,
    )
    return _Matches(*figures)


@compiled
def _normal_equations(
    T_target_source: FloatArray,
    source_m: FloatArray,
    source_normals: FloatArray,
    source_variance_m2: FloatArray,
    target_m: FloatArray,
    target_normals: FloatArray,
    target_variance_m2: FloatArray,
    row: IntArray,
    oriented: bool,
    min_normal_cosine: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The fields of ``_Matches``: robustly weighted normal equations (Geman-McClure) of the
    residuals along the mean of both normals, about the matched points' centre."""
    candidates, samples = row.shape
    matched = np.zeros(candidates, dtype=np.int64)
    centre_m, spread_m = np.zeros((candidates, 3)), np.zeros(candidates)
    information, gradient = np.zeros((candidates, 6, 6)), np.zeros((candidates, 6))
    point_m, normal = np.empty((samples, 3)), np.empty((samples, 3))
    residual_m, variance_m2 = np.empty(samples), np.empty(samples)
    jacobian = np.empty(6)
    for c in range(candidates):
        T = T_target_source[c]
        count = 0
        for s in range(samples):
            t = row[c, s]
            if t < 0:
                continue
            cosine = 0.0
            for i in range(3):
                point_m[count, i] = T[i, 3]
                normal[count, i] = 0.0
                for j in range(3):
                    point_m[count, i] += T[i, j] * source_m[s, j]
                    normal[count, i] += T[i, j] * source_normals[s, j]
                cosine += normal[count, i] * target_normals[t, i]
            side = -1.0 if cosine < 0 and not oriented else 1.0
            if not side * cosine > min_normal_cosine:
                continue
            length = np.sqrt(2 + 2 * side * cosine)  # of the sum of two unit normals
            residual_m[count] = 0.0
            for i in range(3):
                normal[count, i] = (side * normal[count, i] + target_normals[t, i]) / length
                residual_m[count] += normal[count, i] * (target_m[t, i] - point_m[count, i])
                centre_m[c, i] += point_m[count, i]
            variance_m2[count] = source_variance_m2[s] + target_variance_m2[t]
            count += 1
        if count == 0:
            continue
        matched[c] = count
        centre_m[c] /= count
        every = 1 + count // _MEDIAN_SAMPLES
        typical_m2 = np.median(np.abs(residual_m[:count:every])) ** 2
        square_m2 = 0.0
        for k in range(count):
            scale_m2 = 16 * typical_m2 + variance_m2[k]
            robust = scale_m2 / (scale_m2 + residual_m[k] * residual_m[k])
            weight = robust * robust / (variance_m2[k] + typical_m2)
            x, y = point_m[k, 0] - centre_m[c, 0], point_m[k, 1] - centre_m[c, 1]
            z = point_m[k, 2] - centre_m[c, 2]
            square_m2 += x * x + y * y + z * z
            n_x, n_y, n_z = normal[k, 0], normal[k, 1], normal[k, 2]
            jacobian[0], jacobian[1] = y * n_z - z * n_y, z * n_x - x * n_z
            jacobian[2], jacobian[3] = x * n_y - y * n_x, n_x
            jacobian[4], jacobian[5] = n_y, n_z
            for i in range(6):
                weighted = weight * jacobian[i]
                gradient[c, i] += weighted * residual_m[k]
                for j in range(i + 1):
                    information[c, i, j] += weighted * jacobian[j]
        spread_m[c] = np.sqrt(square_m2 / count)
        for i in range(6):
            for j in range(i):
                information[c, j, i] = information[c, i, j]
    return matched, centre_m, spread_m, information, gradient


def _gauss_newton_step(T: FloatArray, matches: _Matches) -> tuple[FloatArray, float]:
    """Move every pose by its normal equations' solution; directions left free stay put."""
    diagonal = np.einsum("cii->ci", matches.information)
    # Mean squared lever of the rotation: what it moves where the normals feel it.
    weight = diagonal[:, 3:].sum(axis=1, keepdims=True)
    square_m2 = diagonal[:, :3].sum(axis=1, keepdims=True) / np.maximum(weight, 1e-12)
    one_voxel = weight / np.maximum(matches.matched[:, None], 1)
    damping = DAMPING_VOXELS * one_voxel * np.repeat(np.hstack([square_m2, [[1.0]] * len(T)]), 3, 1)
    damping += 1e-12
    step = np.linalg.solve(
        matches.information + np.eye(6) * damping[..., None], matches.gradient[..., None]
    )[..., 0]
    rotation = rotation_from_vector(step[:, :3])
    about_m = matches.centre_m
    shift_m = about_m - np.einsum("cij,cj->ci", rotation, about_m) + step[:, 3:]
    turned_m = np.linalg.norm(step[:, :3], axis=1) * np.sqrt(square_m2[:, 0])
    moved_m = np.linalg.norm(step[:, 3:], axis=1) + turned_m
    return make_transform(rotation, shift_m) @ T, float(moved_m.max())
