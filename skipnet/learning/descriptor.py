"""The learned descriptor: 32 numbers by which a voxel is recognised in another scan.

The network is small enough for NumPy; torch is needed to train it (``descriptor_training``), not to
use it, and importing torch alone would take longer than describing two scans.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.features.cylinders import (
    SECTOR_SIZE,
    SECTORS,
    choose_keypoints,
    cylinder_patches,
    turned_over,
)
from skipnet.features.descriptors import mutual_nearest
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

SHIPPED_WEIGHTS = Path(__file__).parent / "weights" / "descriptor.npz"
MAX_KEYPOINTS = 2000
"""Voxels described per scan: more find few further correspondences and cost as much again."""
KEPT_SHARE = 0.6
"""Of these, the most matchable are matched: the others give far more wrong matches than right."""
LAYERS = ("sector", "mixing", "output", "matchable")
"""Names of the network's linear layers, in order; each stores NAME_weight and NAME_bias."""


@dataclass(frozen=True)
class Descriptor:
    """A trained network and its card."""

    weights: dict[str, FloatArray]
    """Per layer (inputs, units) weights and (units,) biases, float32."""
    card: dict[str, Any]
    """How it came about: configuration, data hash, seed, scores."""

    def __call__(self, patches: FloatArray) -> FloatArray:
        """As ``read``, the descriptors alone."""
        return self.read(patches)[0]

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Descriptors of patches, and how likely each will be found again.

        Every sector is summed up by itself; the five sums are read in each of their five cyclic
        orders, and of every hidden unit the strongest response counts. So a turn about the normal
        by whole sectors changes nothing.

        Args:
            patches: (K, 5, 50) from ``cylinder_patches``.

        Returns:
            (K, D) float32 of length 1; the nearer two are, the likelier they show the same place.
            (K,) float32 logits: above 0 where a patch of the same place, in another scan, is more
            likely than not to be told from all others.

        Raises:
            ValueError: patches of another shape.
        """
        if patches.ndim != 3 or patches.shape[1:] != (SECTORS, SECTOR_SIZE):
            raise ValueError(f"patches must be (K, {SECTORS}, {SECTOR_SIZE}), got {patches.shape}")
        hidden = self._hidden(patches)
        described = self._layer("output", hidden)
        described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
        return described, self._layer("matchable", hidden)[:, 0]

    def _hidden(self, patches: FloatArray) -> FloatArray:
        sectors = self._layer("sector", patches.reshape(-1, SECTOR_SIZE))
        once = np.maximum(sectors, 0, out=sectors).reshape(len(patches), -1)
        twice = np.concatenate([once, once], axis=1)  # every cyclic order is a window of this
        units, size = once.shape[1] // SECTORS, once.shape[1]
        mixing = self.weights["mixing_weight"]
        strongest = once @ mixing
        for order in range(1, SECTORS):
            response = twice[:, order * units : order * units + size] @ mixing
            np.maximum(strongest, response, out=strongest)
        strongest += self.weights["mixing_bias"]
        return np.maximum(strongest, 0, out=strongest)

    def _layer(self, name: str, values: FloatArray) -> FloatArray:
        result = values @ self.weights[f"{name}_weight"]
        result += self.weights[f"{name}_bias"]
        return result


def describe_keypoints(
    skipmap: SkipMap,
    descriptor: Descriptor,
    both_sides: bool = False,
    max_keypoints: int = MAX_KEYPOINTS,
) -> tuple[IntArray, FloatArray]:
    """The voxels of a scan that are likeliest to be recognised in another, and their descriptors.

    Args:
        skipmap: the scan's Skip-map.
        descriptor: from ``load_descriptor``.
        both_sides: describe each voxel with both signs of its normal.
        max_keypoints: voxels described, the most curved ones; the most matchable are returned.

    Returns:
        (K,) rows of the Skip-map, a row twice at most if both sides are described, and (K, D).
    """
    rows = choose_keypoints(skipmap, max_keypoints)
    patches = cylinder_patches(skipmap, rows)
    if both_sides:
        patches = np.concatenate([patches, turned_over(patches)])
        rows = np.concatenate([rows, rows])
    described, matchable = descriptor.read(patches)
    kept = np.argsort(-matchable, kind="stable")[: int(np.ceil(KEPT_SHARE * len(rows)))]
    return rows[kept], described[kept]


def correspond(
    source: SkipMap,
    target: SkipMap,
    descriptor: Descriptor,
    max_keypoints: int = MAX_KEYPOINTS,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of two scans that recognise each other.

    Where a viewpoint is unknown the signs of the normals say nothing: then the target is
    described with both.

    Args:
        source: Skip-map of the source.
        target: Skip-map of the target.
        descriptor: from ``load_descriptor``.
        max_keypoints: voxels described per scan, see ``describe_keypoints``.

    Returns:
        (C,) rows of the source, (C,) rows of the target and (C,) distances between their
        descriptors: 0 equal, 2 opposed.
    """
    unknown = source.viewpoint_m is None or target.viewpoint_m is None
    with ThreadPoolExecutor(2) as pool:  # NumPy and SciPy let both scans be described at once
        described = pool.map(
            describe_keypoints,
            (source, target),
            [descriptor] * 2,
            (False, unknown),
            [max_keypoints] * 2,
        )
        (rows_s, described_s), (rows_t, described_t) = described
    of_source, of_target, distance = mutual_nearest(described_s, described_t)
    return rows_s[of_source], rows_t[of_target], distance


def save_descriptor(descriptor: Descriptor, path: Path) -> None:
    """Write the weights, in float16, to ``path`` (.npz) and the card beside them (.json)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    halves = {name: array.astype(np.float16) for name, array in descriptor.weights.items()}
    np.savez_compressed(path, allow_pickle=False, **halves)
    path.with_suffix(".json").write_text(json.dumps(descriptor.card, indent=2) + "\n")


def load_descriptor(path: Path = SHIPPED_WEIGHTS) -> Descriptor:
    """Read weights and card, by default the ones that ship with the package.

    Raises:
        FileNotFoundError: no weights or no card there.
        ValueError: the file holds other weights than the network's.
    """
    card_path = path.with_suffix(".json")
    for file in (path, card_path):
        if not file.is_file():
            raise FileNotFoundError(
                f"no descriptor file {file}; python train.py experiment=descriptor writes one"
            )
    with np.load(path, allow_pickle=False) as arrays:
        weights = {name: arrays[name].astype(np.float32) for name in arrays.files}
    expected = {f"{layer}_{kind}" for layer in LAYERS for kind in ("weight", "bias")}
    if set(weights) != expected:
        raise ValueError(f"{path} holds {sorted(weights)}, expected {sorted(expected)}")
    return Descriptor(weights, json.loads(card_path.read_text()))
