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
from skipnet.geometry import invert
from skipnet.metrics.correspondences import TwoScans, true_correspondences
from skipnet.parallel.pools import Each
from skipnet.progress import counted
from skipnet.simulation.scanning.degrading import degrade, fields_of_view, fused
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.simulation.scanning.recipe import Recipe
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.types import FloatArray, IntArray

T = TypeVar("T")
DEFAULT_RECIPE = Recipe()
MIN_POINTS = 3000
"""A scan with fewer points teaches nothing ..."""
MIN_POINTS_LEFT = 300
"""... nor one with fewer left when it has been thinned out and torn."""
MIN_CORRESPONDENCES = 100


@dataclass(frozen=True)
class PatchPairs:
    """K pairs of patches from one pair of scans; row k of every array shows the same place."""

    source: FloatArray
    """(K, ...) float16, as the network to be trained reads them."""
    target: FloatArray
    """(K, ...) float16."""
    places: FloatArray
    """(K, 3) float32 where they are, in voxels: near ones are no examples of different places."""

    def __len__(self) -> int:
        return len(self.places)


def make_patch_pairs(
    families: Sequence[str],
    seeds: Iterable[int],
    per_scans: int,
    recipe: Recipe = DEFAULT_RECIPE,
    each: Each = map,
) -> list[PatchPairs]:
    """Simulate pairs of scans of the families in turn and cut out pairs of patches.

    Args:
        families: names among ``simulation.scenes.scenes.FAMILIES``; seed k takes family k modulo
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
    families: Sequence[str], seeds: Iterable[int], recipe: Recipe = DEFAULT_RECIPE, each: Each = map
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
    return list(counted("pairs of scans", each(work, names, seeds), len(seeds)))


def digest(pairs: Sequence[PatchPairs]) -> str:
    """Hash of all patches: two data sets with the same digest are the same."""
    sha = hashlib.sha256()
    for one in pairs:
        sha.update(one.source.tobytes())
        sha.update(one.target.tobytes())
    return sha.hexdigest()[:16]


def simulate_two_scans(family: str, seed: int, recipe: Recipe = DEFAULT_RECIPE) -> TwoScans | None:
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
    clouds_m = fused(scans) if kind == "fused" else [scan.points_m for scan in scans]
    if kind == "camera":
        clouds_m = fields_of_view(clouds_m, T_target_source, recipe.aim_error, rng)
    if min(len(cloud_m) for cloud_m in clouds_m) < MIN_POINTS:
        return None
    usual_m = choose_voxel_size(clouds_m[1], clouds_m[0])
    voxel_size_m = usual_m * 2 ** rng.uniform(-recipe.voxel_octaves, recipe.voxel_octaves)
    noise_m = voxel_size_m * rng.choice(recipe.noise_voxels)
    spoilt_m = [degrade(cloud_m, voxel_size_m, noise_m, recipe, rng) for cloud_m in clouds_m]
    if min(len(cloud_m) for cloud_m in spoilt_m) < MIN_POINTS_LEFT:
        return None
    viewpoint_m = None if kind == "fused" else np.zeros(3)
    target, source = (build_skipmap(cloud_m, voxel_size_m, viewpoint_m) for cloud_m in spoilt_m)
    return TwoScans(source, target, T_target_source, oriented=kind != "fused")


def _pairs_of_scene(per_scans: int, recipe: Recipe, family: str, seed: int) -> PatchPairs | None:
    scans = simulate_two_scans(family, seed, recipe)
    if scans is None:
        return None
    return cut_pairs(
        scans, per_scans, recipe, np.random.default_rng([seed, 2]), cylinder_patches, turned_over
    )


def cut_pairs(
    scans: TwoScans,
    per_scans: int,
    recipe: Recipe,
    rng: np.random.Generator,
    cut: Callable[[SkipMap, IntArray], FloatArray],
    turn_over: Callable[[FloatArray], FloatArray],
) -> PatchPairs | None:
    """Draw voxels that two scans share and cut out what is around them.

    Args:
        scans: with the truth.
        per_scans: pairs of patches at most.
        recipe: how many of them are drawn by curvature, and how often they are seen from the back.
        rng: draws.
        cut: what a network reads of voxels, see ``Model``.
        turn_over: what the opposite normals make of that.

    Returns:
        None where the scans share too little.
    """
    rows_s, rows_t, agree = true_correspondences(scans)
    if len(rows_s) < MIN_CORRESPONDENCES:
        return None
    curved = scans.source.curvatures[rows_s] + 1e-4
    chance = recipe.curved_share * curved / curved.sum()
    chance += (1 - recipe.curved_share) / len(curved)
    drawn = rng.choice(len(rows_s), min(per_scans, len(rows_s)), replace=False, p=chance)
    rows_s, rows_t, agree = rows_s[drawn], rows_t[drawn], agree[drawn]
    source, target = cut(scans.source, rows_s), cut(scans.target, rows_t)
    opposed = agree.reshape(-1, *[1] * (target.ndim - 1)) < 0
    target = np.where(opposed, turn_over(target), target)
    if rng.random() < recipe.turned_share:
        source, target = turn_over(source), turn_over(target)
    places = scans.source.centroids_m[rows_s] / scans.source.voxel_size_m
    return PatchPairs(
        source.astype(np.float16), target.astype(np.float16), places.astype(np.float32)
    )
