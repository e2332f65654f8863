"""Candidate poses where planes leave one direction open: every position along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.clouds.statistics import largest
from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses
from skipnet.registration.hypotheses.plane_offsets import (
    MOST_DIRECTIONS,
    main_directions,
    offset_constraints,
    vote,
)
from skipnet.registration.hypotheses.plane_rotations import plane_rotations
from skipnet.types import FloatArray

_PAIRS = tuple(np.triu_indices(count, 1) for count in range(MOST_DIRECTIONS + 1))
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
    supports = [slides.support for slides in found]
    support = np.concatenate([np.zeros(0), *supports])
    best = largest(support, max_slides)
    sizes = np.array([len(one) for one in supports], dtype=np.int64)
    before = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(found)), sizes)[best]
    if len(best) == 0:
        return NO_HYPOTHESES
    chosen, which = np.unique(owner, return_inverse=True)  # most lines share it with others
    rotations = np.stack([found[k].rotation for k in chosen])
    directions = np.stack([found[k].direction for k in chosen])
    extents_m = _extents_m(rotations, directions, source_m, target_m, voxel_size_m)
    rotations, directions, first_m, last_m = (
        of_each[which] for of_each in (rotations, directions, *extents_m)
    )
    rows = best - before[owner]
    starts_m = np.stack([found[k].start_m(row) for k, row in zip(owner, rows, strict=True)])
    steps = np.ceil((last_m - first_m) / voxel_size_m).astype(np.int64)
    line = np.repeat(np.arange(len(best)), steps)
    step = np.arange(len(line)) - (np.cumsum(steps) - steps)[line]
    along_m = (first_m[line] + step * voxel_size_m) - (starts_m * directions).sum(axis=1)[line]
    places_m = starts_m[line] + along_m[:, None] * directions[line]
    return Hypotheses(make_transform(rotations[line], places_m), support[best][line])


@dataclass(frozen=True)
class _Slides:
    """Parallel lines of translations for one rotation."""

    rotation: FloatArray
    direction: FloatArray
    to_start: FloatArray
    """(3, 2) from the shifts along two directions to where a line starts."""
    shifts_m: tuple[FloatArray, FloatArray]
    """(I,) along the one and (J,) along the other: there are I * J lines."""
    weights: tuple[FloatArray, FloatArray]
    """Of the shifts."""

    @property
    def support(self) -> FloatArray:
        """(I * J,)."""
        return np.add.outer(*self.weights).ravel()

    def start_m(self, row: int) -> FloatArray:
        """(3,) where one of the lines starts."""
        shift_i, shift_j = self.shifts_m
        i, j = divmod(row, len(shift_j))
        start_m: FloatArray = self.to_start @ [shift_i[i], shift_j[j]]
        return start_m


def _extents_m(
    rotations: FloatArray,
    directions: FloatArray,
    source_m: FloatArray,
    target_m: FloatArray,
    voxel_size_m: float,
) -> tuple[FloatArray, FloatArray]:
    """(K,) from where and (K,) to where along each of (K, 3) directions scans can still meet, the
    source turned by (K, 3, 3), up to ``MOST_STEPS``."""
    moved_m = np.einsum("kij,ki->kj", rotations, directions) @ source_m.T
    along_m = directions @ target_m.T
    first_m, last_m = (
        along_m.min(axis=1) - moved_m.max(axis=1),
        along_m.max(axis=1) - moved_m.min(axis=1),
    )
    far = last_m - first_m > MOST_STEPS * voxel_size_m
    if far.any():
        middle_m = np.median(along_m[far], axis=1) - np.median(moved_m[far], axis=1)
        half_m = MOST_STEPS / 2 * voxel_size_m
        first_m[far] = np.maximum(first_m[far], middle_m - half_m)
        last_m[far] = np.minimum(last_m[far], middle_m + half_m)
    return first_m, last_m


def _slides(
    rotation: FloatArray, source: Planes, target: Planes, voxel_size_m: float, max_angle_rad: float
) -> list[_Slides]:
    """Lines on which the offsets of two directions' planes agree, for each two of them."""
    normals, shift_m, weight = offset_constraints(rotation, source, target, max_angle_rad)
    axes = main_directions(normals, weight)
    if len(axes) < 2:
        return []
    votes = [vote(normals @ axis, shift_m, weight, voxel_size_m, count=6) for axis in axes]
    i, j = _PAIRS[len(axes)]
    directions = _across(axes[i], axes[j])
    to_start = np.linalg.inv(np.stack([axes[i], axes[j], directions], axis=1))[:, :, :2]
    return [
        _Slides(rotation, directions[k], to_start[k], *zip(votes[i[k]], votes[j[k]], strict=True))
        for k in range(len(i))
    ]


def _across(first: FloatArray, second: FloatArray) -> FloatArray:
    """(K, 3) unit directions across (K, 3) and (K, 3) others."""
    after, before = [1, 2, 0], [2, 0, 1]  # np.cross takes ten times as long for a few
    across = first[:, after] * second[:, before] - first[:, before] * second[:, after]
    unit: FloatArray = across / np.sqrt((across * across).sum(axis=1, keepdims=True))
    return unit
