"""Pairs of patches that show the same place, from simulated scenes: the descriptor's examples.

Two scans of one scene are degraded as real ones are, each in its own way, and the voxels that
coincide under the known motion become pairs of patches.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from skipnet.features.cylinders import cylinder_patches, turned_over
from skipnet.features.frames import tangent_frames
from skipnet.geometry import invert, transform_points
from skipnet.processes import Each
from skipnet.simulation.pairs import simulate_scans
from skipnet.simulation.scanner import SimulatedScan
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.types import FloatArray, IntArray

T = TypeVar("T")
SAME_PLACE_VOXELS = 0.7
"""Voxels of two scans show the same place when their centroids are nearer, and ..."""
SAME_PLACE_COSINE = 0.8
"""... their normals differ by less than the angle of this cosine."""
MIN_POINTS = 3000
"""A scan with fewer points teaches nothing ..."""
MIN_POINTS_LEFT = 300
"""... nor one with fewer left when it has been thinned out and torn."""
MIN_CORRESPONDENCES = 100


@dataclass(frozen=True)
class Recipe:
    """How scenes are scanned, spoilt and cut into examples; every share is one of pairs of scans.

    All lengths follow the voxel size, which is drawn too: so nothing here has a scale.
    """

    rings_share: float = 0.25
    """Taken by a spinning scanner of 16 channels."""
    camera_share: float = 0.25
    """Seen by two cameras of a narrow view that look at about the same point."""
    fused_share: float = 0.2
    """Fused from two places each, so that the normals' sides mean nothing."""
    aim_error: float = 0.2
    """How far apart the cameras aim, as a share of their distance from the point."""
    voxel_octaves: float = 1.0
    """The usual voxel size is multiplied by a power of two between minus and plus this."""
    noise_voxels: tuple[float, ...] = (0.0, 0.05, 0.15)
    """Deviations of the points' noise, one of which is drawn."""
    least_kept: float = 0.3
    """Between this share of the points and all of them are kept, in each scan another."""
    holes: int = 6
    """Up to so many balls of points are taken out of each scan, as by things in front of it."""
    curved_share: float = 0.8
    """So many of the examples are drawn by curvature, as keypoints are; the rest evenly."""
    turned_share: float = 0.4
    """Seen from the back of their surfaces: without a viewpoint, any side may be up."""


@dataclass(frozen=True)
class TwoScans:
    """Two degraded scans of a scene as Skip-maps of one voxel size, and the truth."""

    source: SkipMap
    target: SkipMap
    T_target_source: FloatArray
    """(4, 4)"""
    oriented: bool
    """Whether both were taken from one place each, so that their normals look to it."""


@dataclass(frozen=True)
class PatchPairs:
    """K pairs of patches from one pair of scans; row k of every array shows the same place."""

    source: FloatArray
    """(K, 5, 100) float16."""
    target: FloatArray
    """(K, 5, 100) float16."""
    places: FloatArray
    """(K, 3) float32 where they are, in voxels: near ones are no examples of different places."""

    def __len__(self) -> int:
        return len(self.places)


def make_patch_pairs(
    families: Sequence[str],
    seeds: Iterable[int],
    per_scans: int,
    recipe: Recipe = Recipe(),
    each: Each = map,
) -> list[PatchPairs]:
    """Simulate pairs of scans of the families in turn and cut out pairs of patches.

    Args:
        families: names of ``skipnet.simulation.scenes.FAMILIES``; seed k takes family k modulo
            their number.
        seeds: of the scenes and of all that is drawn for them.
        per_scans: pairs of patches from one pair of scans, at most.
        recipe: of the scans.
        each: ``map``, or what does the same in several processes; the result is the same.

    Returns:
        One entry per seed whose scans share enough, in order.

    Raises:
        ValueError: no family, or a family that does not exist.
    """
    work = partial(_pairs_of_scene, per_scans, recipe)
    return [pairs for pairs in _each_scene(work, families, seeds, each) if pairs is not None]


def make_scans(
    families: Sequence[str], seeds: Iterable[int], recipe: Recipe = Recipe(), each: Each = map
) -> list[TwoScans]:
    """As ``make_patch_pairs``, the scans themselves: those that are left with enough points."""
    work = partial(simulate_two_scans, recipe=recipe)
    return [scans for scans in _each_scene(work, families, seeds, each) if scans is not None]


def _each_scene(
    work: Callable[[str, int], T], families: Sequence[str], seeds: Iterable[int], each: Each
) -> list[T]:
    """What ``work`` makes of every seed and its family, in order."""
    if not families:
        raise ValueError("no scenes: give at least one family")
    seeds = list(seeds)
    names = [families[seed % len(families)] for seed in seeds]
    return list(each(work, names, seeds))


def digest(pairs: Sequence[PatchPairs]) -> str:
    """Hash of all patches: two data sets with the same digest are the same."""
    sha = hashlib.sha256()
    for one in pairs:
        sha.update(one.source.tobytes())
        sha.update(one.target.tobytes())
    return sha.hexdigest()[:16]


def simulate_two_scans(family: str, seed: int, recipe: Recipe = Recipe()) -> TwoScans | None:
    """Two scans of scene ``seed``, spoilt as the recipe says; None when too little is left."""
    rng = np.random.default_rng([seed, 1])
    kinds = {
        "rings": recipe.rings_share,
        "camera": recipe.camera_share,
        "fused": recipe.fused_share,
    }
    chances = [*kinds.values(), 1 - sum(kinds.values())]
    kind = rng.choice([*kinds, "dome"], p=chances)
    # Of a camera's beams its narrow view keeps a tenth or two.
    few_or_many = int(rng.choice([60_000, 200_000, 400_000]))
    beams = {"rings": None, "camera": 500_000}.get(kind, few_or_many)
    scanner = "rings" if kind == "rings" else "terrestrial"
    scans, _ = simulate_scans(family, seed, 4 if kind == "fused" else 2, scanner, "any", beams)
    T_target_source = invert(scans[0].T_world_sensor) @ scans[1].T_world_sensor
    clouds_m = _fused(scans) if kind == "fused" else [scan.points_m for scan in scans]
    if kind == "camera":
        clouds_m = _fields_of_view(clouds_m, T_target_source, recipe.aim_error, rng)
    if min(len(cloud_m) for cloud_m in clouds_m) < MIN_POINTS:
        return None
    usual_m = choose_voxel_size(clouds_m[1], clouds_m[0])
    voxel_size_m = usual_m * 2 ** rng.uniform(-recipe.voxel_octaves, recipe.voxel_octaves)
    noise_m = voxel_size_m * rng.choice(recipe.noise_voxels)
    spoilt_m = [_spoil(cloud_m, voxel_size_m, noise_m, recipe, rng) for cloud_m in clouds_m]
    if min(len(cloud_m) for cloud_m in spoilt_m) < MIN_POINTS_LEFT:
        return None
    viewpoint_m = None if kind == "fused" else np.zeros(3)
    target, source = (build_skipmap(cloud_m, voxel_size_m, viewpoint_m) for cloud_m in spoilt_m)
    return TwoScans(source, target, T_target_source, oriented=kind != "fused")


def true_correspondences(scans: TwoScans) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of both scans that coincide under the truth.

    Returns:
        (C,) rows of the source, (C,) rows of the target, and (C,) 1 where their surfaces' axes
        agree, -1 where they are opposed; that can only be where the scans are not oriented.
    """
    from scipy.spatial import cKDTree

    source, target = scans.source, scans.target
    moved_m = transform_points(scans.T_target_source, source.centroids_m)
    reach_m = SAME_PLACE_VOXELS * source.voxel_size_m
    distance_m, nearest = cKDTree(target.centroids_m).query(moved_m, distance_upper_bound=reach_m)
    rows_s = np.flatnonzero(np.isfinite(distance_m))
    rows_t = nearest[rows_s]
    axes_s, axes_t = (
        tangent_frames(skipmap, rows)[:, :, 0]
        for skipmap, rows in ((source, rows_s), (target, rows_t))
    )
    cosine = np.einsum("ci,ci->c", axes_s @ scans.T_target_source[:3, :3].T, axes_t)
    agree = (cosine if scans.oriented else np.abs(cosine)) > SAME_PLACE_COSINE
    return rows_s[agree], rows_t[agree], np.sign(cosine[agree])


def _fused(scans: Sequence[SimulatedScan]) -> list[FloatArray]:
    """Target and source clouds, each joined with a further scan: they have no one viewpoint."""
    clouds_m = []
    for one, more in zip(scans[:2], scans[2:], strict=True):
        T_one_more = invert(one.T_world_sensor) @ more.T_world_sensor
        clouds_m.append(np.concatenate([one.points_m, transform_points(T_one_more, more.points_m)]))
    return clouds_m


def _fields_of_view(
    clouds_m: list[FloatArray],
    T_target_source: FloatArray,
    aim_error: float,
    rng: np.random.Generator,
) -> list[FloatArray]:
    """What two cameras of a narrow view keep that look at about the same point."""
    focus_m = clouds_m[0][rng.integers(len(clouds_m[0]))]
    half_angle_rad = np.deg2rad(rng.uniform(25, 50))
    kept = []
    for cloud_m, T_target_cloud in zip(clouds_m, [np.eye(4), T_target_source], strict=True):
        axis_m = transform_points(invert(T_target_cloud), focus_m[None])[0]
        axis_m = axis_m + rng.normal(0, aim_error, 3) * np.linalg.norm(axis_m)
        cosine = cloud_m @ axis_m / np.linalg.norm(cloud_m, axis=1) / np.linalg.norm(axis_m)
        kept.append(cloud_m[cosine > np.cos(half_angle_rad)])
    return kept


def _spoil(
    points_m: FloatArray,
    voxel_size_m: float,
    noise_m: float,
    recipe: Recipe,
    rng: np.random.Generator,
) -> FloatArray:
    """Thin the points out, tear holes and shake what is left."""
    kept = rng.random(len(points_m)) < rng.uniform(recipe.least_kept, 1.0)
    points_m = points_m.take(np.flatnonzero(kept), axis=0)
    x_m, y_m, z_m = np.ascontiguousarray(points_m.T)
    whole = np.ones(len(points_m), dtype=bool)
    for x, y, z in points_m[rng.integers(len(points_m), size=rng.integers(recipe.holes + 1))]:
        radius_m = voxel_size_m * rng.uniform(2, 12)
        whole &= (x_m - x) ** 2 + (y_m - y) ** 2 + (z_m - z) ** 2 > radius_m**2
    left_m = points_m.take(np.flatnonzero(whole), axis=0)
    return left_m + rng.normal(0, noise_m, left_m.shape)


def _pairs_of_scene(per_scans: int, recipe: Recipe, family: str, seed: int) -> PatchPairs | None:
    scans = simulate_two_scans(family, seed, recipe)
    if scans is None:
        return None
    rows_s, rows_t, agree = true_correspondences(scans)
    if len(rows_s) < MIN_CORRESPONDENCES:
        return None
    rng = np.random.default_rng([seed, 2])
    curved = scans.source.curvatures[rows_s] + 1e-4
    chance = recipe.curved_share * curved / curved.sum()
    chance += (1 - recipe.curved_share) / len(curved)
    drawn = rng.choice(len(rows_s), min(per_scans, len(rows_s)), replace=False, p=chance)
    rows_s, rows_t, agree = rows_s[drawn], rows_t[drawn], agree[drawn]
    source = cylinder_patches(scans.source, rows_s)
    target = cylinder_patches(scans.target, rows_t)
    target = np.where(agree[:, None, None] < 0, turned_over(target), target)
    if rng.random() < recipe.turned_share:
        source, target = turned_over(source), turned_over(target)
    places = scans.source.centroids_m[rows_s] / scans.source.voxel_size_m
    return PatchPairs(
        source.astype(np.float16), target.astype(np.float16), places.astype(np.float32)
    )
