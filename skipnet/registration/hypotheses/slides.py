"""Candidate poses where planes leave one direction open: every position along it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

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
    found = []
    for rotation in plane_rotations(source, target, max_rotations, max_angle_rad):
        normals, shift_m, weight = offset_constraints(rotation, source, target, max_angle_rad)
        if len(normals):
            found += _lines_of_translation(rotation, normals, shift_m, weight, voxel_size_m)
    found = sorted(found, key=lambda slide: -slide.support)[:max_slides]
    return concatenate([_walk(slide, source_m, target_m, voxel_size_m) for slide in found])


@dataclass(frozen=True)
class _Slide:
    """A line of translations for one rotation."""

    rotation: FloatArray
    start_m: FloatArray
    direction: FloatArray
    support: float


def _lines_of_translation(
    rotation: FloatArray,
    normals: FloatArray,
    shift_m: FloatArray,
    weight: FloatArray,
    voxel_size_m: float,
) -> list[_Slide]:
    """Lines on which the offsets of two directions' planes agree."""
    directions = main_directions(normals, weight)
    votes = [vote(normals @ axis, shift_m, weight, voxel_size_m, count=6) for axis in directions]
    slides = []
    for i, j in combinations(range(len(directions)), 2):
        direction = np.cross(directions[i], directions[j])
        direction /= np.linalg.norm(direction)
        to_start = np.linalg.inv(np.array([directions[i], directions[j], direction]))[:, :2]
        for (shift_i, weight_i), (shift_j, weight_j) in product(
            zip(*votes[i], strict=True), zip(*votes[j], strict=True)
        ):
            start_m = to_start @ np.array([shift_i, shift_j])
            slides.append(_Slide(rotation, start_m, direction, float(weight_i + weight_j)))
    return slides


def _walk(
    slide: _Slide, source_m: FloatArray, target_m: FloatArray, voxel_size_m: float
) -> Hypotheses:
    """Poses a voxel apart on a slide, as far as the scans can still meet, up to ``MOST_STEPS``."""
    moved_m = source_m @ (slide.rotation.T @ slide.direction)
    along_m = target_m @ slide.direction
    first_m, last_m = along_m.min() - moved_m.max(), along_m.max() - moved_m.min()
    if last_m - first_m > MOST_STEPS * voxel_size_m:
        middle_m, half_m = np.median(along_m) - np.median(moved_m), MOST_STEPS / 2 * voxel_size_m
        first_m, last_m = max(first_m, middle_m - half_m), min(last_m, middle_m + half_m)
    steps_m = np.arange(first_m, last_m, voxel_size_m) - slide.start_m @ slide.direction
    translations_m = slide.start_m + steps_m[:, None] * slide.direction
    rotations = np.broadcast_to(slide.rotation, (len(steps_m), 3, 3))
    T_target_source = make_transform(rotations, translations_m)
    return Hypotheses(T_target_source, np.full(len(steps_m), slide.support))
