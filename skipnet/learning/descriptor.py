"""The learned descriptor: 32 numbers by which a voxel is recognised in another scan.

The network is small enough for NumPy; torch is needed to train it (``descriptor_training``), not to
use it, and importing torch alone would take longer than describing two scans.
"""

from __future__ import annotations

import json
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
MAX_KEYPOINTS = 5000
"""Voxels described per scan: more find few further correspondences."""
LAYERS = ("first", "second", "output")
"""Names of the network's linear layers, in order; each stores NAME_weight and NAME_bias."""


@dataclass(frozen=True)
class Descriptor:
    """A trained network and its card."""

    weights: dict[str, FloatArray]
    """Per layer (inputs, units) weights and (units,) biases, float32."""
    card: dict[str, Any]
    """How it came about: configuration, data hash, seed, scores."""

    def __call__(self, patches: FloatArray) -> FloatArray:
        """Descriptors of patches: the five sectors are read in each of their five cyclic orders,
        and of every hidden unit the strongest response counts.

        So a turn about the normal by whole sectors changes nothing.

        Args:
            patches: (K, 5, 75) from ``cylinder_patches``.

        Returns:
            (K, D) float32 of length 1; the nearer two are, the likelier they show the same place.

        Raises:
            ValueError: patches of another shape.
        """
        if patches.ndim != 3 or patches.shape[1:] != (SECTORS, SECTOR_SIZE):
            raise ValueError(f"patches must be (K, {SECTORS}, {SECTOR_SIZE}), got {patches.shape}")
        once = patches.reshape(len(patches), -1)
        twice = np.concatenate([once, once], axis=1)  # every cyclic order is a window of this
        strongest = np.zeros(0, dtype=np.float32)
        for order in range(SECTORS):
            window = twice[:, order * SECTOR_SIZE : (order + SECTORS) * SECTOR_SIZE]
            hidden = self._layer("first", window, rectify=True)
            response = self._layer("second", hidden, rectify=True)
            strongest = np.maximum(strongest, response) if order else response
        described = self._layer("output", strongest, rectify=False)
        length = np.linalg.norm(described, axis=1, keepdims=True)
        return described / np.maximum(length, np.float32(1e-12))

    def _layer(self, name: str, values: FloatArray, rectify: bool) -> FloatArray:
        result = values @ self.weights[f"{name}_weight"]
        result += self.weights[f"{name}_bias"]
        return np.maximum(result, 0, out=result) if rectify else result


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
        max_keypoints: voxels described per scan, the most curved ones.

    Returns:
        (C,) rows of the source, (C,) rows of the target and (C,) distances between their
        descriptors: 0 equal, 2 opposed.
    """
    rows_s, rows_t = (choose_keypoints(scan, max_keypoints) for scan in (source, target))
    described_s = descriptor(cylinder_patches(source, rows_s))
    patches_t = cylinder_patches(target, rows_t)
    if source.viewpoint_m is None or target.viewpoint_m is None:
        patches_t = np.concatenate([patches_t, turned_over(patches_t)])
        rows_t = np.concatenate([rows_t, rows_t])
    described_t = descriptor(patches_t)
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
