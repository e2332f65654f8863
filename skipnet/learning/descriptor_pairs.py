"""Pairs of patches that show the same place, from simulated scenes: the descriptor's examples.

Two scans of one scene are degraded as real ones are, each in its own way, and the voxels that
coincide under the known motion become pairs of patches.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

import numpy as np

from skipnet.features.cylinders import cylinder_patches, turned_over
from skipnet.geometry import invert, transform_points
from skipnet.simulation.pairs import simulate_scans
from skipnet.simulation.scanner import SimulatedScan
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.types import FloatArray, IntArray

SAME_PLACE_VOXELS = 0.7
"""Voxels of two scans show the same place when their centroids are nearer, and ..."""
SAME_PLACE_COSINE = 0.8
"""... their normals differ by less than the angle of this cosine."""
MIN_POINTS = 3000
"""A scan with fewer points left teaches nothing."""
MIN_CORRESPONDENCES = 100
_CURVED_SHARE = 0.8
"""Most pairs are drawn by curvature, as keypoints are; the rest evenly."""
_TURNED_SHARE = 0.4
"""Pairs of scans seen from the back of their surfaces: without a viewpoint, any side may be up."""


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
    """(K, 5, 75) float16."""
    target: FloatArray
    """(K, 5, 75) float16."""
    places: FloatArray
    """(K, 3) float32 where they are, in voxels: near ones are no examples of different places."""

    def __len__(self) -> int:
        return len(self.places)


def make_patch_pairs(
    families: Sequence[str], seeds: Iterable[int], per_scans: int, workers: int = 1
) -> list[PatchPairs]:
    """Simulate pairs of scans of the families in turn and cut out pairs of patches.

    Args:
        families: names of ``skipnet.simulation.scenes.FAMILIES``; seed k takes family k modulo
            their number.
        seeds: of the scenes and of all that is drawn for them.
        per_scans: pairs of patches from one pair of scans, at most.
        workers: processes; the result is the same for any number of them.

    Returns:
        One entry per seed whose scans share enough, in order.

    Raises:
        ValueError: no family, or a family that does not exist.
    """
    if not families:
        raise ValueError("no scenes: give at least one family")
    work = partial(_pairs_of_scene, tuple(families), per_scans)
    if workers == 1:
        made = [work(seed) for seed in seeds]
    else:  # fresh processes: a forked one would inherit the locks of Open3D's and torch's threads
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            made = list(pool.map(work, seeds, chunksize=4))
    return [pairs for pairs in made if pairs is not None]


def digest(pairs: Sequence[PatchPairs]) -> str:
    """Hash of all patches: two data sets with the same digest are the same."""
    sha = hashlib.sha256()
    for one in pairs:
        sha.update(one.source.tobytes())
        sha.update(one.target.tobytes())
    return sha.hexdigest()[:16]


def simulate_two_scans(family: str, seed: int) -> TwoScans | None:
    """Two scans of scene ``seed``; None when too little is left of them.

    Scanner, field of view, density, noise and voxel size (half to twice the usual one) are drawn
    anew for every seed; a quarter of the domes are fused from two places each.
    """
    rng = np.random.default_rng([seed, 1])
    scanner = "rings" if rng.random() < 0.25 else "terrestrial"
    view = "dome" if scanner == "rings" else rng.choice(["dome", "camera"], p=[0.7, 0.3])
    fused = view == "dome" and rng.random() < 0.25
    beams = None if scanner == "rings" else int(rng.choice([60_000, 200_000, 400_000]))
    if view == "camera":
        beams = 800_000  # of which it keeps a tenth or two
    scans, _ = simulate_scans(family, seed, 4 if fused else 2, scanner, "any", beams)
    T_target_source = invert(scans[0].T_world_sensor) @ scans[1].T_world_sensor
    clouds_m = _fused(scans) if fused else [scan.points_m for scan in scans]
    if view == "camera":
        clouds_m = _fields_of_view(clouds_m, T_target_source, rng)
    if min(len(cloud_m) for cloud_m in clouds_m) < MIN_POINTS:
        return None
    voxel_size_m = choose_voxel_size(clouds_m[1], clouds_m[0]) * 2 ** rng.uniform(-1, 1)
    noise_m = voxel_size_m * rng.choice([0.0, 0.05, 0.15])
    degraded_m = [_degrade(cloud_m, noise_m, rng) for cloud_m in clouds_m]
    target, source = (build_skipmap(points_m, voxel_size_m, np.zeros(3)) for points_m in degraded_m)
    return TwoScans(source, target, T_target_source, oriented=not fused)


def true_correspondences(scans: TwoScans) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of both scans that coincide under the truth.

    Returns:
        (C,) rows of the source, (C,) rows of the target, and (C,) 1 where their normals agree,
        -1 where they are opposed; that can only be where the scans are not oriented.
    """
    from scipy.spatial import cKDTree

    source, target = scans.source, scans.target
    moved_m = transform_points(scans.T_target_source, source.centroids_m)
    reach_m = SAME_PLACE_VOXELS * source.voxel_size_m
    distance_m, nearest = cKDTree(target.centroids_m).query(moved_m, distance_upper_bound=reach_m)
    rows_s = np.flatnonzero(np.isfinite(distance_m))
    rows_t = nearest[rows_s]
    turned = source.normals[rows_s] @ scans.T_target_source[:3, :3].T
    cosine = np.einsum("ci,ci->c", turned, target.normals[rows_t])
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
    clouds_m: list[FloatArray], T_target_source: FloatArray, rng: np.random.Generator
) -> list[FloatArray]:
    """What two cameras of a narrow view keep that look at about the same point."""
    focus_m = clouds_m[0][rng.integers(len(clouds_m[0]))]
    half_angle_rad = np.deg2rad(rng.uniform(25, 50))
    kept = []
    for cloud_m, T_target_cloud in zip(clouds_m, [np.eye(4), T_target_source], strict=True):
        aim_m = focus_m + rng.normal(0, 0.3, 3)
        axis_m = transform_points(invert(T_target_cloud), aim_m[None])[0]
        cosine = cloud_m @ axis_m / np.linalg.norm(cloud_m, axis=1) / np.linalg.norm(axis_m)
        kept.append(cloud_m[cosine > np.cos(half_angle_rad)])
    return kept


def _degrade(points_m: FloatArray, noise_m: float, rng: np.random.Generator) -> FloatArray:
    """Keep 30 to 100 % of the points and shake them."""
    kept_m = points_m[rng.random(len(points_m)) < rng.uniform(0.3, 1.0)]
    return kept_m + rng.normal(0, noise_m, kept_m.shape)


def _pairs_of_scene(families: Sequence[str], per_scans: int, seed: int) -> PatchPairs | None:
    scans = simulate_two_scans(families[seed % len(families)], seed)
    if scans is None:
        return None
    rows_s, rows_t, agree = true_correspondences(scans)
    if len(rows_s) < MIN_CORRESPONDENCES:
        return None
    rng = np.random.default_rng([seed, 2])
    curved = scans.source.curvatures[rows_s] + 1e-4
    chance = _CURVED_SHARE * curved / curved.sum() + (1 - _CURVED_SHARE) / len(curved)
    drawn = rng.choice(len(rows_s), min(per_scans, len(rows_s)), replace=False, p=chance)
    rows_s, rows_t, agree = rows_s[drawn], rows_t[drawn], agree[drawn]
    source = cylinder_patches(scans.source, rows_s)
    target = cylinder_patches(scans.target, rows_t)
    target = np.where(agree[:, None, None] < 0, turned_over(target), target)
    if rng.random() < _TURNED_SHARE:
        source, target = turned_over(source), turned_over(target)
    places = scans.source.centroids_m[rows_s] / scans.source.voxel_size_m
    return PatchPairs(
        source.astype(np.float16), target.astype(np.float16), places.astype(np.float32)
    )
