"""Fine alignment: ICP on Skip-map voxels with oriented normals, from coarse level to fine.

Each source voxel corresponds to the target voxel it falls into, if their normals agree: the two
sides of a wall never match. Residuals are taken along the normals (symmetric point-to-plane) and
weighted by what the voxels' moments say about their own accuracy, so flat, well-filled voxels
decide and rough ones hardly count. A correspondence is one table lookup; no search tree is built.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import invert
from skipnet.registration.alignment.normal_equations import Matches, Surfaces, match_surfaces
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

MIN_MATCHES = 50
"""Fewer correspondences at a level say nothing."""
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

    @property
    def weakest_std_m(self) -> FloatArray:
        """(C,) standard deviation of how far the matched points move in the small motion that is
        held least."""
        lever_m = np.repeat(np.stack([self.spread_m, np.ones(len(self.spread_m))], axis=1), 3, 1)
        moved_m2 = self.covariance * lever_m[:, :, None] * lever_m[:, None]
        std_m: FloatArray = np.sqrt(np.maximum(np.linalg.eigvalsh(moved_m2)[:, -1], 0.0))
        return std_m

    def __getitem__(self, rows: IntArray | slice) -> Refinement:
        """The candidates of some rows."""
        return Refinement(*(getattr(self, one.name)[rows] for one in fields(self)))

    def joined(self, others: Refinement) -> Refinement:
        """These candidates, then the others."""
        pairs = ((getattr(self, one.name), getattr(others, one.name)) for one in fields(self))
        return Refinement(*(np.concatenate(pair) for pair in pairs))

    def where(self, good: BoolArray, other: Refinement) -> Refinement:
        """These candidates where (C,) ``good`` says so, elsewhere those of the other."""
        return Refinement(
            np.where(good[:, None, None], self.T_target_source, other.T_target_source),
            np.where(good[:, None, None], self.information, other.information),
            np.where(good, self.matched, other.matched),
            np.where(good[:, None], self.centre_m, other.centre_m),
            np.where(good, self.spread_m, other.spread_m),
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
    result = no_refinement(T)
    for source, target in levels:
        if min(len(source), len(target)) == 0:
            continue  # a level without surfaces has no hold
        rows = _spread_rows(len(source), samples)
        surfaces = Surfaces.of(source, rows), Surfaces.of(target, slice(None))
        for _ in range(max_steps):
            matches = match_surfaces(T, *surfaces, target.table, min_normal_cosine)
            T, moved_m = gauss_newton_step(T, matches)
            if moved_m < 1e-4 * target.voxel_size_m:
                break
        result = _keep_tracked(result, T, matches, 1.5 * target.voxel_size_m)
        T = result.T_target_source
    return result


def no_refinement(T: FloatArray) -> Refinement:
    """(C, 4, 4) poses as they are before any level: nothing holds them."""
    count = len(T)
    matched = np.zeros(count, dtype=np.int64)
    return Refinement(T, np.zeros((count, 6, 6)), matched, np.zeros((count, 3)), np.zeros(count))


def _keep_tracked(
    before: Refinement, T: FloatArray, matches: Matches, max_shift_m: float
) -> Refinement:
    """Take over a level's poses, but for those that ran away: too sparse a level has no hold."""
    before_m = apply(before.T_target_source, apply(invert(T), matches.centre_m))
    shift_m = np.linalg.norm(matches.centre_m - before_m, axis=1)
    good = (matches.matched >= MIN_MATCHES) & (shift_m < max_shift_m)
    after = Refinement(T, matches.information, matches.matched, matches.centre_m, matches.spread_m)
    return after.where(good, before)


def apply(T_a_b: FloatArray, point_b_m: FloatArray) -> FloatArray:
    """Map one (C, 3) point by each of (C, 4, 4) transforms."""
    return np.einsum("cij,cj->ci", T_a_b[:, :3, :3], point_b_m) + T_a_b[:, :3, 3]


def _spread_rows(count: int, samples: int | None) -> IntArray | slice:
    """Evenly spread rows; the tree's order walks through space, so they cover the whole scan."""
    if samples is None or samples >= count:
        return slice(None)
    return np.linspace(0, count - 1, samples).astype(np.int64)


def gauss_newton_step(T: FloatArray, matches: Matches) -> tuple[FloatArray, float]:
    """Move every pose by its normal equations' solution; directions left free stay put."""
    moved, moved_m = np.empty_like(T), np.empty(len(T))
    equations = matches.information, matches.gradient
    _step_all(T, *equations, matches.matched, matches.centre_m, np.empty((6, 8)), moved, moved_m)
    return moved, float(moved_m.max())


@compiled
def _step_all(
    T_target_source: FloatArray,
    information: FloatArray,
    gradient: FloatArray,
    matched: IntArray,
    centre_m: FloatArray,
    room: FloatArray,
    moved: FloatArray,
    moved_m: FloatArray,
) -> None:
    """(C, 4, 4) poses moved by a step about (C, 3) centres, and (C,) how far it moves what the
    normals feel. The room is (6, 8): a pose's equations, their solution in column 6."""
    for c in range(len(T_target_source)):
        turning = information[c, 0, 0] + information[c, 1, 1] + information[c, 2, 2]
        weight = information[c, 3, 3] + information[c, 4, 4] + information[c, 5, 5]
        # Mean squared lever of the rotation: what it moves where the normals feel it.
        square_m2 = turning / max(weight, 1e-12)
        one_voxel = DAMPING_VOXELS * weight / max(matched[c], 1)
        for i in range(6):
            for j in range(6):
                room[i, j] = information[c, i, j]
            room[i, i] += one_voxel * (square_m2 if i < 3 else 1.0) + 1e-12
            room[i, 6] = gradient[c, i]
        _solve(room)
        x, y, z = room[0, 6], room[1, 6], room[2, 6]
        angle_rad = np.sqrt(x * x + y * y + z * z)
        once, twice = 1.0, 0.5
        if angle_rad > 0:  # Rodrigues' formula
            once = np.sin(angle_rad) / angle_rad
            twice = 2 * (np.sin(angle_rad / 2) / angle_rad) ** 2
        cross = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
        for i in range(3):
            for j in range(3):
                room[i, j] = once * cross[i][j] + (1.0 if i == j else 0.0)
                for k in range(3):
                    room[i, j] += twice * cross[i][k] * cross[k][j]
        for i in range(3):
            shift_m = centre_m[c, i] + room[3 + i, 6]
            for k in range(3):
                shift_m -= room[i, k] * centre_m[c, k]
            for j in range(4):
                moved[c, i, j] = shift_m if j == 3 else 0.0
                for k in range(3):
                    moved[c, i, j] += room[i, k] * T_target_source[c, k, j]
            moved[c, 3, i] = 0.0
        moved[c, 3, 3] = 1.0
        u, v, w = room[3, 6], room[4, 6], room[5, 6]
        moved_m[c] = np.sqrt(u * u + v * v + w * w) + angle_rad * np.sqrt(square_m2)


@compiled
def _solve(room: FloatArray) -> None:
    """Solve the positive definite (6, 6) equations in the room, right side in column 6, in place:
    elimination without a choice of rows, which such equations do not need."""
    for i in range(6):
        for j in range(i + 1, 6):
            share = room[j, i] / room[i, i]
            for k in range(i, 7):
                room[j, k] -= share * room[i, k]
    for step in range(6):
        i = 5 - step
        for k in range(i + 1, 6):
            room[i, 6] -= room[i, k] * room[k, 6]
        room[i, 6] /= room[i, i]
