"""Candidate poses where planes leave one direction open: every position along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform
from skipnet.registration.hypotheses.hypotheses import Hypotheses, concatenate
from skipnet.registration.hypotheses.plane_offsets import main_directions, offset_constraints, vote
from skipnet.registration.hypotheses.plane_rotations import plane_rotations
from skipnet.types import FloatArray

MOST_STEPS = 4096
"""On a slide: scans are some hundreds of voxels wide, but for stray points very far away."""


def from_slides(
    source: Planes,
    target: Planes,
    source_m: FloatArray,
    target_m: FloatArray,
    voxel_size_m: float,
    max_rotations: int = 40,
    max_slides: int = 150,
    max_angle_rad: float = 0.06,
) -> Hypotheses:
    """Where planes fix all but one direction: every position along it, a voxel apart.

    Two rooms seen through a door may share floor and end walls, and nothing else that is flat.
    What is left is one line of translations per pair of directions; the judge walks along it.

    Args:
        source: planes of the source.
        target: planes of the target.
        source_m: (V, 3) the source's voxels; their extent bounds the slide ...
        target_m: (W, 3) ... together with the target's.
        voxel_size_m: step of the slide.
        max_rotations: distinct rotations to try.
        max_slides: lines to walk, those on which most area agrees.
        max_angle_rad: largest disagreement of angles between planes.
    """
    found = [
        slides
        for rotation in plane_rotations(source, target, max_rotations, max_angle_rad)
        for slides in _slides(rotation, source, target, voxel_size_m, max_angle_rad)
    ]
    support = np.concatenate([np.zeros(0), *(slides.support for slides in found)])
    owner = np.repeat(np.arange(len(found)), [len(slides.support) for slides in found])
    row = np.concatenate([np.zeros(0, int), *(np.arange(len(one.support)) for one in found)])
    best = np.argsort(-support, kind="stable")[:max_slides]
    extents_m = {k: found[k].extent_m(source_m, target_m, voxel_size_m) for k in {*owner[best]}}
    walks = (found[owner[k]].walk(row[k], extents_m[owner[k]], voxel_size_m) for k in best)
    return concatenate(list(walks))


@dataclass(frozen=True)
class _Slides:
    """Parallel lines of translations for one rotation."""

    rotation: FloatArray
    direction: FloatArray
    starts_m: FloatArray
    """(K, 3)."""
    support: FloatArray
    """(K,)."""

    def extent_m(
        self, source_m: FloatArray, target_m: FloatArray, voxel_size_m: float
    ) -> tuple[float, float]:
        """From where to where the scans can still meet, up to ``MOST_STEPS``."""
        moved_m = source_m @ (self.rotation.T @ self.direction)
        along_m = target_m @ self.direction
        first_m, last_m = along_m.min() - moved_m.max(), along_m.max() - moved_m.min()
        if last_m - first_m > MOST_STEPS * voxel_size_m:
            middle_m = np.median(along_m) - np.median(moved_m)
            half_m = MOST_STEPS / 2 * voxel_size_m
            first_m, last_m = max(first_m, middle_m - half_m), min(last_m, middle_m + half_m)
        return first_m, last_m

    def walk(self, row: int, extent_m: tuple[float, float], voxel_size_m: float) -> Hypotheses:
        """Poses a voxel apart on one of the lines."""
        start_m = self.starts_m[row]
        steps_m = np.arange(*extent_m, voxel_size_m) - start_m @ self.direction
        rotations = np.broadcast_to(self.rotation, (len(steps_m), 3, 3))
        T_target_source = make_transform(rotations, start_m + steps_m[:, None] * self.direction)
        return Hypotheses(T_target_source, np.full(len(steps_m), self.support[row]))


def _slides(
    rotation: FloatArray, source: Planes, target: Planes, voxel_size_m: float, max_angle_rad: float
) -> list[_Slides]:
    """Lines on which the offsets of two directions' planes agree, for each two of them."""
    normals, shift_m, weight = offset_constraints(rotation, source, target, max_angle_rad)
    axes = main_directions(normals, weight)
    if len(axes) < 2:
        return []
    votes = [vote(normals @ axis, shift_m, weight, voxel_size_m, count=6) for axis in axes]
    i, j = np.triu_indices(len(axes), 1)
    directions = np.cross(axes[i], axes[j])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    to_start = np.linalg.inv(np.stack([axes[i], axes[j], directions], axis=1))[:, :, :2]
    slides = []
    for k, (first, second) in enumerate(zip(i, j, strict=True)):
        (shift_i, weight_i), (shift_j, weight_j) = votes[first], votes[second]
        both_m = np.stack([np.repeat(shift_i, len(shift_j)), np.tile(shift_j, len(shift_i))], 1)
        support = (weight_i[:, None] + weight_j).ravel()
        slides.append(_Slides(rotation, directions[k], both_m @ to_start[k].T, support))
    return slides
