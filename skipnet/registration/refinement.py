"""Fine alignment: ICP on Skip-map voxels with oriented normals, from coarse level to fine.

Each source voxel corresponds to the target voxel it falls into, if their normals agree: the two
sides of a wall never match. Residuals are taken along the normals (symmetric point-to-plane) and
weighted by what the voxels' moments say about their own accuracy, so flat, well-filled voxels
decide and rough ones hardly count. A correspondence is one table lookup; no search tree is built.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, make_transform, rotation_from_vector
from skipnet.registration.surface_table import SurfaceTable, build_surface_table
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

MIN_MATCHES = 50
"""Fewer correspondences at a level say nothing."""
MODEL_ERROR_VOXELS = 0.002
"""How far a real surface departs from its voxel's plane at best, so that dense voxels do not
decide all."""


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
        sampled = _Surfaces.of(source, _spread_rows(len(source), samples))
        surfaces = _Surfaces.of(target, slice(None))
        table = build_surface_table(target, neighbours=False)
        for _ in range(max_steps):
            matches = _match(T, sampled, surfaces, table, min_normal_cosine)
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
    matched = matches.valid.sum(axis=1)
    before_m = apply(before.T_target_source, apply(invert(T), matches.centre_m))
    shift_m = np.linalg.norm(matches.centre_m - before_m, axis=1)
    good = (matched >= MIN_MATCHES) & (shift_m < max_shift_m)
    return Refinement(
        np.where(good[:, None, None], T, before.T_target_source),
        np.where(good[:, None, None], matches.information, before.information),
        np.where(good, matched, before.matched),
        np.where(good[:, None], matches.centre_m, before.centre_m),
        np.where(good, matches.spread_m, before.spread_m),
    )


@dataclass(frozen=True)
class _Matches:
    """One step's correspondences of C candidates and S voxels, linearised."""

    valid: BoolArray
    centre_m: FloatArray
    spread_m: FloatArray
    information: FloatArray
    gradient: FloatArray


def apply(T_a_b: FloatArray, point_b_m: FloatArray) -> FloatArray:
    """Map one (C, 3) point by each of (C, 4, 4) transforms."""
    return np.einsum("cij,cj->ci", T_a_b[:, :3, :3], point_b_m) + T_a_b[:, :3, 3]


def _spread_rows(count: int, samples: int | None) -> IntArray:
    """Evenly spread rows; the tree's order walks through space, so they cover the whole scan."""
    if samples is None or samples >= count:
        return np.arange(count)
    return np.linspace(0, count - 1, samples).astype(np.int64)


@dataclass(frozen=True)
class _Surfaces:
    """Voxels of one scan by coordinate, which is how they are computed with."""

    centroids_m: FloatArray
    """(3, V)."""
    normals: FloatArray
    """(3, V)."""
    variance_m2: FloatArray
    """(V,) of each centroid along its normal: scatter across the surface over points."""
    oriented: bool

    @staticmethod
    def of(skipmap: SkipMap, rows: IntArray | slice) -> _Surfaces:
        """Some voxels of a Skip-map."""
        floor_m = MODEL_ERROR_VOXELS * skipmap.voxel_size_m
        return _Surfaces(
            np.ascontiguousarray(skipmap.centroids_m[rows].T),
            np.ascontiguousarray(skipmap.normals[rows].T),
            (skipmap.eigenvalues_m2[:, 0] / skipmap.counts + floor_m**2)[rows],
            skipmap.viewpoint_m is not None,
        )


def _match(
    T: FloatArray,
    source: _Surfaces,
    target: _Surfaces,
    table: SurfaceTable,
    min_normal_cosine: float,
) -> _Matches:
    """Correspondences by lookup, and the weighted normal equations of their residuals."""
    points_m = T[:, :3, :3] @ source.centroids_m + T[:, :3, 3:]
    normals = T[:, :3, :3] @ source.normals
    row = table.find(*points_m.transpose(1, 0, 2))
    others = target.normals.take(row, axis=1, mode="wrap").transpose(1, 0, 2)
    cosine = (normals * others).sum(axis=1)
    if not (source.oriented and target.oriented):
        normals, cosine = normals * np.sign(cosine)[:, None], np.abs(cosine)
    valid = (row >= 0) & (cosine > min_normal_cosine)
    normals += others
    normals /= np.maximum(np.sqrt((normals * normals).sum(axis=1)), 1e-9)[:, None]
    apart_m = target.centroids_m.take(row, axis=1, mode="wrap").transpose(1, 0, 2) - points_m
    residual_m = (apart_m * normals).sum(axis=1)
    variance_m2 = source.variance_m2 + target.variance_m2.take(row, mode="wrap")
    return _linearise(points_m, normals, residual_m, variance_m2, valid)


def _linearise(
    points_m: FloatArray,
    normals: FloatArray,
    residual_m: FloatArray,
    variance_m2: FloatArray,
    valid: BoolArray,
) -> _Matches:
    """Robustly weighted normal equations about the matched points' centre (Geman-McClure).

    Args:
        points_m: (C, 3, S) source voxels where the candidates put them.
        normals: (C, 3, S).
        residual_m: (C, S) along the normals.
        variance_m2: (C, S) of these.
        valid: (C, S) what is matched.
    """
    count = np.maximum(valid.sum(axis=1), 1)
    centre_m = (points_m @ valid[..., None])[..., 0] / count[:, None]
    typical_m = np.array(
        [
            np.median(r[v]) if v.any() else 0.0
            for r, v in zip(np.abs(residual_m), valid, strict=True)
        ]
    )
    scale_m2 = (4 * typical_m[:, None]) ** 2 + variance_m2
    robust = (scale_m2 / (scale_m2 + residual_m**2)) ** 2
    weight = np.where(valid, robust / (variance_m2 + typical_m[:, None] ** 2), 0.0)
    x_m, y_m, z_m = (points_m[:, axis] - centre_m[:, axis, None] for axis in range(3))
    n_x, n_y, n_z = (normals[:, axis] for axis in range(3))
    turned = (y_m * n_z - z_m * n_y, z_m * n_x - x_m * n_z, x_m * n_y - y_m * n_x)
    jacobian = np.stack([*turned, n_x, n_y, n_z], axis=1)
    weighted = jacobian * weight[:, None]
    square_m2 = ((x_m * x_m + y_m * y_m + z_m * z_m) * valid).sum(axis=1)
    return _Matches(
        valid,
        centre_m,
        np.sqrt(square_m2 / count),
        weighted @ jacobian.transpose(0, 2, 1),
        (weighted @ residual_m[..., None])[..., 0],
    )


def _gauss_newton_step(T: FloatArray, matches: _Matches) -> tuple[FloatArray, float]:
    """Move every pose by its normal equations' solution; directions left free stay put."""
    diagonal = np.einsum("cii->ci", matches.information)
    # Mean squared lever of the rotation: what it moves where the normals feel it.
    weight = diagonal[:, 3:].sum(axis=1, keepdims=True)
    square_m2 = diagonal[:, :3].sum(axis=1, keepdims=True) / np.maximum(weight, 1e-12)
    one_voxel = weight / np.maximum(matches.valid.sum(axis=1, keepdims=True), 1)
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
