"""Labelled patches from simulated scenes: what the classifier learns from and is judged on."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from skipnet.features.cylinders import SECTORS, cylinder_patches
from skipnet.features.patches import build_patches, feature_voxels
from skipnet.geometry import random_rotation
from skipnet.parallel.pools import Each
from skipnet.progress import counted
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.simulation.scanning.scanner import Scanner, SimulatedScan, find_scanner
from skipnet.simulation.scenes.scenes import Scene
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.training.data.labels import LabelRule, label_positions
from skipnet.training.data.visibility import visible_surface
from skipnet.types import FeatureClass, FloatArray, IntArray

SCANS_PER_SCENE = 2
SAMPLE_SPACING_VOXELS = 0.5
"""Distance of the surface samples that labels are counted from."""


@dataclass(frozen=True)
class Samples:
    """Labelled feature voxels; row k of every array is the same voxel."""

    patches: FloatArray
    """(N, 125) float32."""
    surroundings: FloatArray
    """(N, 5, 100) float16 from ``cylinder_patches``; (N, 5, 0) where none are asked for."""
    labels: IntArray
    """(N,) int64 ``FeatureClass`` values."""
    weights: FloatArray
    """(N,) feature voxels of its class in its scan that a sample stands for; 1 without thinning."""
    ranges_m: FloatArray
    """(N,) distance from the sensor."""
    scenes: IntArray
    """(N,) seed of the scene."""
    families: IntArray
    """(N,) place of the scene's family in the list that was asked for."""

    def __len__(self) -> int:
        return len(self.labels)

    def __getitem__(self, rows: IntArray) -> Samples:
        return Samples(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def digest(self) -> str:
        """Hash of patches and labels: two data sets with the same digest are the same."""
        sha = hashlib.sha256()
        for array in (self.patches, self.surroundings, self.labels):
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()[:16]


@dataclass(frozen=True)
class Labelling:
    """How scans become samples."""

    scanner: str = "terrestrial"
    patch: str = "surface_frame"
    rule: LabelRule = LabelRule()
    turn_second_scan: bool = True
    """Whether the second cloud of a scene is turned at random; else both scanners stand upright."""
    most_per_class: int | None = None
    """Voxels kept of each class and scan, drawn at random; None keeps all."""
    with_surroundings: bool = False
    """Whether to cut out what lies 10 and 20 voxels around, too."""


@dataclass(frozen=True)
class LabelledScan:
    """A scan's Skip-map, which of its voxels are features, and their true classes."""

    skipmap: SkipMap
    voxels: IntArray
    """(K,) rows of the Skip-map."""
    labels: IntArray
    """(K,) ``FeatureClass`` values."""


def make_samples(
    families: Sequence[str], seeds: Iterable[int], labelling: Labelling, each: Each = map
) -> Samples:
    """Simulate scenes of the families in turn and label their feature voxels.

    Args:
        families: names among ``simulation.scenes.scenes.FAMILIES``; seed k takes family k modulo
            their number.
        seeds: of the scenes; each is scanned from two places.
        labelling: scanner, patch and labels.
        each: ``map``, or what does the same in several processes; the result is the same.

    Raises:
        ValueError: no family or no seed, or a family that does not exist.
    """
    seeds = list(seeds)
    if not families or not seeds:
        raise ValueError("no scenes: give at least one family and one seed")
    work = partial(_samples_of_scene, tuple(families), labelling)
    return concatenate(list(counted("labelled scenes", each(work, seeds), len(seeds))))


def concatenate(parts: Sequence[Samples]) -> Samples:
    """All samples, in order; of at least one part."""
    names = [field.name for field in fields(Samples)]
    return Samples(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


def label_scene(
    family: str, seed: int, labelling: Labelling, rng: np.random.Generator
) -> list[LabelledScan]:
    """Scan a scene twice and label the feature voxels, at the voxel size registration would take.

    The first cloud keeps the room's axes; the second is turned as the labelling says.
    """
    scans, scene = simulate_scans(family, seed, SCANS_PER_SCENE, labelling.scanner)
    voxel_size_m = choose_voxel_size(scans[0].points_m, scans[1].points_m)
    turns = [np.eye(3), random_rotation(rng) if labelling.turn_second_scan else np.eye(3)]
    model = find_scanner(labelling.scanner)
    return [
        label_scan(scan, scene, model, voxel_size_m, labelling.rule, turn)
        for scan, turn in zip(scans, turns, strict=True)
    ]


def label_scan(
    scan: SimulatedScan,
    scene: Scene,
    scanner: Scanner,
    voxel_size_m: float,
    rule: LabelRule,
    R_cloud_sensor: FloatArray,
) -> LabelledScan:
    """Build the Skip-map of a scan turned by ``R_cloud_sensor`` and label its feature voxels.

    Voxels around which the sensor can see no surface at all have no truth and are left out: only
    range noise could have put them there.
    """
    points_m = scan.points_m.astype(np.float64) @ R_cloud_sensor.T
    skipmap = build_skipmap(points_m, voxel_size_m, np.zeros(3))
    voxels = feature_voxels(skipmap)
    visible = visible_surface(
        scene, scanner, scan.T_world_sensor, SAMPLE_SPACING_VOXELS * voxel_size_m
    )
    positions_m = skipmap.centroids_m[voxels] @ R_cloud_sensor
    labels = label_positions(positions_m, visible, voxel_size_m, rule)
    return LabelledScan(skipmap, voxels[labels >= 0], labels[labels >= 0])


def _samples_of_scene(families: Sequence[str], labelling: Labelling, seed: int) -> Samples:
    family = seed % len(families)
    turn_rng, thin_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    scans = label_scene(families[family], seed, labelling, turn_rng)
    return concatenate(
        [_samples_of_scan(scan, family, seed, labelling, thin_rng) for scan in scans]
    )


def _samples_of_scan(
    scan: LabelledScan, family: int, seed: int, labelling: Labelling, rng: np.random.Generator
) -> Samples:
    rows, weights = thin(scan.labels, labelling.most_per_class, rng)
    voxels = scan.voxels[rows]
    if labelling.with_surroundings:
        surroundings = cylinder_patches(scan.skipmap, voxels).astype(np.float16)
    else:
        surroundings = np.zeros((len(rows), SECTORS, 0), dtype=np.float16)
    return Samples(
        patches=build_patches(scan.skipmap, voxels, labelling.patch),
        surroundings=surroundings,
        labels=scan.labels[rows],
        weights=weights,
        ranges_m=np.linalg.norm(scan.skipmap.centroids_m[voxels], axis=1),
        scenes=np.full(len(rows), seed),
        families=np.full(len(rows), family),
    )


def thin(
    labels: IntArray, most_per_class: int | None, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Draw at most so many rows of each class.

    Returns:
        (M,) ascending rows and (M,) the number of rows each stands for.
    """
    order = rng.permutation(len(labels))
    order = order[np.argsort(labels[order], kind="stable")]
    counts = np.bincount(labels, minlength=len(FeatureClass))
    rank = np.arange(len(order)) - (np.cumsum(counts) - counts)[labels[order]]
    most = len(labels) if most_per_class is None else most_per_class
    rows = np.sort(order[rank < most])
    kept = np.minimum(counts, most)
    return rows, counts[labels[rows]] / np.maximum(kept, 1)[labels[rows]]
