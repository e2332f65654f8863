"""Hypotheses from planes: three walls, floors or fronts of different directions fix a pose."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from skipnet.features.primitives import Planes
from skipnet.geometry import make_transform
from skipnet.registration.hypotheses.hypotheses import NO_HYPOTHESES, Hypotheses, concatenate
from skipnet.registration.hypotheses.plane_rotations import oblique_pairs, plane_rotations
from skipnet.types import FloatArray

MOST_STEPS = 4096
"""On a slide: scans are some hundreds of voxels wide, but for stray points very far away."""
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
        normals, shift_m, weight = _offset_constraints(rotation, source, target, max_angle_rad)
        if len(normals):
            found += _lines_of_translation(rotation, normals, shift_m, weight, voxel_size_m)
    found = sorted(found, key=lambda slide: -slide.support)[:max_slides]
    return concatenate([_walk(slide, source_m, target_m, voxel_size_m) for slide in found])


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
    directions = _directions(normals, weight)
    votes = [_vote(normals @ axis, shift_m, weight, voxel_size_m, count=6) for axis in directions]
    slides = []
    for i, j in combinations(range(len(directions)), 2):
        direction = np.cross(directions[i], directions[j])
        direction /= np.linalg.norm(direction)
        axes = np.array([directions[i], directions[j], direction])
        for (shift_i, weight_i), (shift_j, weight_j) in product(
            zip(*votes[i], strict=True), zip(*votes[j], strict=True)
        ):
            start_m = np.linalg.solve(axes, np.array([shift_i, shift_j, 0.0]))
            slides.append(_Slide(rotation, start_m, direction, float(weight_i + weight_j)))
    return slides


def _walk(
    slide: _Slide, source_m: FloatArray, target_m: FloatArray, voxel_size_m: float
) -> Hypotheses:
    """Poses a voxel apart on a slide, as far as the scans can still meet, up to ``MOST_STEPS``."""
    moved_m = source_m @ (slide.rotation.T @ slide.direction)
    along_m = target_m @ slide.direction
    first_m, last_m = along_m.min() - moved_m.max(), along_m.max() - moved_m.min()
    middle_m, half_m = np.median(along_m) - np.median(moved_m), MOST_STEPS / 2 * voxel_size_m
    first_m, last_m = max(first_m, middle_m - half_m), min(last_m, middle_m + half_m)
    steps_m = np.arange(first_m, last_m, voxel_size_m) - slide.start_m @ slide.direction
    translations_m = slide.start_m + steps_m[:, None] * slide.direction
    rotations = np.broadcast_to(slide.rotation, (len(steps_m), 3, 3))
    T_target_source = make_transform(rotations, translations_m)
    return Hypotheses(T_target_source, np.full(len(steps_m), slide.support))


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
    normals, shift_m, weight = _offset_constraints(rotation, source, target, max_angle_rad)
    if len(normals) == 0:
        return NO_HYPOTHESES
    directions = _directions(normals, weight)
    votes = [_vote(normals @ axis, shift_m, weight, voxel_size_m) for axis in directions]
    solved = [
        _solve(directions[list(triple)], [votes[axis] for axis in triple])
        for triple in combinations(range(len(directions)), 3)
    ]
    translations_m = np.concatenate([np.zeros((0, 3)), *solved])
    agree = np.abs(translations_m @ normals.T - shift_m) < voxel_size_m
    support = agree @ weight
    best = np.argsort(-support, kind="stable")[:count]
    rotations = np.broadcast_to(rotation, (len(best), 3, 3))
    return Hypotheses(make_transform(rotations, translations_m[best]), support[best])


def _offset_constraints(
    rotation: FloatArray, source: Planes, target: Planes, max_angle_rad: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What each pair of parallel planes asks of the translation: n . t = shift, with a weight.

    Returns:
        (P, 3) target normals, (P,) shifts in metres, (P,) square roots of the shared area.
    """
    cosine = target.normals @ (source.normals @ rotation.T).T
    t, s = np.nonzero(cosine > np.cos(1.5 * max_angle_rad))
    normals = target.normals[t]
    moved_m = source.centroids_m[s] @ rotation.T
    shift_m = target.offsets_m[t] - (normals * moved_m).sum(axis=1)
    return normals, shift_m, np.sqrt(np.minimum(target.weights[t], source.weights[s]))


def _directions(normals: FloatArray, weights: FloatArray, count: int = 5) -> FloatArray:
    """(D, 3) directions of much area, at least 20 degrees apart, either sign."""
    free = np.ones(len(normals), dtype=bool)
    axes: list[FloatArray] = []
    while free.any() and len(axes) < count:
        axes.append(normals[np.where(free, weights, -1).argmax()])
        free &= np.abs(normals @ axes[-1]) < np.cos(np.deg2rad(20))
    return np.array(axes)


def _vote(
    along: FloatArray, shift_m: FloatArray, weights: FloatArray, width_m: float, count: int = 16
) -> tuple[FloatArray, FloatArray]:
    """The ``count`` shifts along a direction with most weight within ``width_m``, and that weight.

    Args:
        along: (P,) cosine between each pair's normal and the direction; parallel ones of either
            sign vote.
        shift_m: (P,) shift along its own normal that each pair asks for.
        weights: (P,) of the pairs.
        width_m: shifts closer than this support each other.
        count: peaks to return.
    """
    parallel = np.abs(along) > np.cos(0.12)
    offsets_m, weights = shift_m[parallel] * np.sign(along[parallel]), weights[parallel]
    near = np.abs(offsets_m[:, None] - offsets_m) < width_m
    support = near @ weights
    mean_m = (near @ (weights * offsets_m)) / support
    order = np.argsort(-support, kind="stable")
    mean_m, support = mean_m[order], support[order]
    apart = np.abs(mean_m[:, None] - mean_m) > width_m
    left, peaks = np.ones(len(mean_m), dtype=bool), list[int]()
    while left.any() and len(peaks) < count:
        peaks.append(int(left.argmax()))
        left &= apart[peaks[-1]]
        left[peaks[-1]] = False
    return mean_m[peaks], support[peaks]


def _solve(
    axes: FloatArray, votes: list[tuple[FloatArray, FloatArray]], count: int = 1500
) -> FloatArray:
    """(M, 3) translations from all combinations of three directions' peaks, strongest first."""
    if abs(np.linalg.det(axes)) < 0.2:
        return np.zeros((0, 3))
    (shift_i, weight_i), (shift_j, weight_j), (shift_k, weight_k) = votes
    support = (weight_i[:, None, None] + weight_j[:, None] + weight_k).ravel()
    if len(support) > count:
        strongest = np.argpartition(-support, count)[:count]
    else:
        strongest = np.arange(len(support))
    i, j, k = np.unravel_index(strongest, (len(shift_i), len(shift_j), len(shift_k)))
    shifts_m = np.stack([shift_i[i], shift_j[j], shift_k[k]])
    return (np.linalg.inv(axes) @ shifts_m).T
