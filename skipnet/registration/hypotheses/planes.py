"""Hypotheses from planes: three walls, floors or fronts of different directions fix a pose."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from skipnet.clouds.statistics import largest
from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses, concatenate
from skipnet.registration.hypotheses.plane_offsets import main_directions, offset_constraints, vote
from skipnet.registration.hypotheses.plane_rotations import oblique_pairs, plane_rotations
from skipnet.types import FloatArray

MIN_DETERMINANT = 0.2
"""Of three unit directions that are to fix a translation."""
MIN_ALIGNED = 0.7
"""Right rotations align this share of the area that the best one does, and more, where scans share
much (0.84 in simulated rooms and doorways). Elsewhere ``from_slides`` tries the other rotations.
"""


def from_planes(
    source: Planes,
    target: Planes,
    voxel_size_m: float,
    max_rotations: int = 60,
    per_rotation: int = 120,
    max_angle_rad: float = 0.06,
) -> Hypotheses:
    """Rotations from pairs of planes at equal angles, translations from parallel planes' offsets.

    Where a scan has planes of one direction only, each large one is laid on each of the other
    scan: all that they fix.

    Args:
        source: planes of the source, normals towards its sensor (or with both signs).
        target: planes of the target, likewise.
        voxel_size_m: offsets that differ by less support the same translation.
        max_rotations: distinct rotations to keep.
        per_rotation: translations to keep for each.
        max_angle_rad: largest disagreement of angles between planes.
    """
    if min(_count_directions(planes) for planes in (source, target)) == 1:
        return _plane_on_plane(source, target)
    rotations = plane_rotations(source, target, max_rotations, max_angle_rad, MIN_ALIGNED)
    stacks = [
        _plane_translations(rotation, source, target, voxel_size_m, per_rotation, max_angle_rad)
        for rotation in rotations
    ]
    return concatenate([stack for stack in stacks if len(stack)])


def _count_directions(planes: Planes) -> int:
    """Of how many kinds the planes are: 0 none, 1 all parallel, 2 for more."""
    return 2 if len(oblique_pairs(planes.normals, ordered=False)[0]) else min(len(planes), 1)


def _plane_on_plane(source: Planes, target: Planes, count: int = 4) -> Hypotheses:
    """Each of the largest planes of both scans on each other, centroid on centroid.

    The turn in the plane is free; the frames' own axes choose it, one way and the other.
    """
    s, t = (rows.ravel() for rows in np.indices((len(source), len(target)))[:, :count, :count])
    frames_s, frames_t = _upright_frames(source.normals[s]), _upright_frames(target.normals[t])
    half_turn = np.diag([1.0, -1.0, -1.0])
    rotations = np.concatenate(
        [frames_t @ frames_s.transpose(0, 2, 1), frames_t @ half_turn @ frames_s.transpose(0, 2, 1)]
    )
    s, t = np.tile(s, 2), np.tile(t, 2)
    moved_m = np.einsum("rij,rj->ri", rotations, source.centroids_m[s])
    T_target_source = make_transform(rotations, target.centroids_m[t] - moved_m)
    return Hypotheses(T_target_source, np.minimum(source.weights[s], target.weights[t]))


def _upright_frames(normals: FloatArray) -> FloatArray:
    """(P, 3, 3) right-handed frames in columns: the normal, and the coordinate axes' way in it."""
    axes = np.eye(3)[np.abs(normals).argmin(axis=1)]
    second = np.cross(normals, axes)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    return np.stack([normals, second, np.cross(normals, second)], axis=-1)


def _plane_translations(
    rotation: FloatArray,
    source: Planes,
    target: Planes,
    voxel_size_m: float,
    count: int,
    max_angle_rad: float,
) -> Hypotheses:
    """Translations on which offsets of parallel planes agree; any three directions may fix one.

    In two rooms seen through a door no pair of large walls may correspond along one axis; a slanted
    cupboard front, small as it is, then holds what the walls cannot.
    """
    normals, shift_m, weight = offset_constraints(rotation, source, target, max_angle_rad)
    if len(normals) == 0:
        return NO_HYPOTHESES
    directions = main_directions(normals, weight)
    votes = [vote(normals @ axis, shift_m, weight, voxel_size_m) for axis in directions]
    translations_m = np.concatenate([np.zeros((0, 3)), *_solved(directions, votes)])
    agree = np.abs(translations_m @ normals.T - shift_m) < voxel_size_m
    support = agree @ weight
    best = largest(support, count)
    rotations = np.broadcast_to(rotation, (len(best), 3, 3))
    return Hypotheses(make_transform(rotations, translations_m[best]), support[best])


def _solved(directions: FloatArray, votes: list[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
    """(M, 3) translations from the peaks of each three directions that are far from one plane."""
    triples = np.array(list(combinations(range(len(directions)), 3)), dtype=np.int64)
    if len(triples) == 0:
        return []
    triples = triples[np.abs(np.linalg.det(directions[triples])) >= MIN_DETERMINANT]
    inverses = np.linalg.inv(directions[triples])
    return [
        _combined([votes[axis] for axis in triple]) @ inverse.T
        for triple, inverse in zip(triples, inverses, strict=True)
    ]


def _combined(votes: list[tuple[FloatArray, FloatArray]], count: int = 1500) -> FloatArray:
    """(M, 3) all combinations of three directions' peaks; of very many the heaviest."""
    (shift_i, weight_i), (shift_j, weight_j), (shift_k, weight_k) = votes
    sizes = len(shift_i), len(shift_j), len(shift_k)
    rows = np.arange(math.prod(sizes))
    if len(rows) > count:
        support = (weight_i[:, None, None] + weight_j[:, None] + weight_k).ravel()
        rows = np.argpartition(-support, count)[:count]
    i, j, k = np.unravel_index(rows, sizes)
    return np.stack([shift_i[i], shift_j[j], shift_k[k]], axis=1)
