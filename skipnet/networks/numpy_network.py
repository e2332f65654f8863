"""The learned network: what a voxel is, and 32 numbers to recognise it by in another scan.

One network with two heads. What lies 10 and 20 voxels around a voxel, in cylinders about its
surface's axis, gives hidden units; the descriptor reads these alone, the classes read these and the
paper's 125 cells about the voxel itself, on which they live. Whoever only looks for
correspondences never cuts out the latter.

It is small enough for NumPy; torch is needed to train it (``descriptor_training``), not to use it,
and importing torch alone would take longer than describing two scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from skipnet.features.cylinders import (
    SECTOR_SIZE,
    SECTORS,
)
from skipnet.features.patches import PATCH_SIZE
from skipnet.types import FloatArray

_CHUNK = 256
"""Voxels that the network reads at a time: what it computes stays in the processor's cache."""
SHARED_LAYERS = ("sector", "mixing", "output", "matchable")
"""Linear layers of the descriptor; the first two give hidden units, which the classes read too."""
CLASS_LAYERS = ("detail", "joint", "classes")
"""Linear layers of the class head. Of each layer NAME_weight and NAME_bias are stored."""


def cyclic_basis() -> FloatArray:
    """(5, 5) real Fourier basis over the sectors in rows: mean, cosine and sine of 1, 2 turns."""
    angle = 2 * np.pi / SECTORS * np.arange(SECTORS)
    waves = [wave(turns * angle) for turns in (1, 2) for wave in (np.cos, np.sin)]
    basis = np.stack([np.full(SECTORS, np.sqrt(0.5)), *waves]) * np.sqrt(2 / SECTORS)
    return basis.astype(np.float32)


_BASIS = cyclic_basis()
MEAN_GAIN, PLANE_GAIN = np.sqrt(np.array([SECTORS, SECTORS / 2], dtype=np.float32))
"""Lengths that make products of waves of unit length out of a cyclic correlation."""


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

        Args:
            patches: (K, 5, 100) from ``cylinder_patches``.

        Returns:
            (K, D) float32 of length 1; the nearer two are, the likelier they show the same place.
            (K,) float32 logits: above 0 where a patch of the same place, in another scan, is more
            likely than not to be told from all others.

        Raises:
            ValueError: patches of another shape.
        """
        hidden = self.hidden(patches)
        described = self._layer("output", hidden)
        described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
        return described, self._layer("matchable", hidden)[:, 0]

    def classify(self, details: FloatArray, patches: FloatArray) -> FloatArray:
        """Probabilities of the five classes.

        Args:
            details: (K, 125) from ``build_patches``, of kind "surface_frame".
            patches: (K, 5, 100) of the same voxels, from ``cylinder_patches``.

        Returns:
            (K, 5) float32, columns in the order of ``FeatureClass``; each row sums to 1.

        Raises:
            ValueError: patches of another shape.
        """
        if details.shape != (len(patches), PATCH_SIZE):
            expected = (len(patches), PATCH_SIZE)
            raise ValueError(f"details must be {expected}, got {details.shape}")
        detail = _gelu(self._layer("detail", details))
        joint = np.concatenate([detail, self.hidden(patches)], axis=1)
        logits = self._layer("classes", _gelu(self._layer("joint", joint)))
        odds = np.exp(logits - logits.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True)

    def hidden(self, patches: FloatArray) -> FloatArray:
        """(K, H) what both heads read of (K, 5, 100) patches, a few voxels at a time."""
        if patches.ndim != 3 or patches.shape[1:] != (SECTORS, SECTOR_SIZE):
            raise ValueError(f"patches must be (K, {SECTORS}, {SECTOR_SIZE}), got {patches.shape}")
        hidden = np.empty((len(patches), len(self.weights["mixing_bias"])), dtype=np.float32)
        for start in range(0, len(patches), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            hidden[chunk] = self._hidden_of_few(patches[chunk].astype(np.float32, copy=False))
        return hidden

    def _hidden_of_few(self, patches: FloatArray) -> FloatArray:
        """(K, H) what both heads read.

        Every sector is summed up by itself; the five sums are read in each of their five cyclic
        orders, and of every hidden unit the strongest response counts. So a turn about the axis
        by whole sectors changes nothing. Over the Fourier basis a cyclic order is a turn of two
        planes, and 9 products do instead of 25.
        """
        sums = _rectify(self._layer("sector", patches.swapaxes(0, 1)))
        waves = (_BASIS @ sums.reshape(SECTORS, -1)).reshape(sums.shape)
        mean, *planes = self._mixing_waves
        units = mean.shape[1]
        responses = np.empty((SECTORS, len(patches), units), dtype=np.float32)
        np.matmul(waves[0], mean, out=responses[0])
        for plane, weights in zip((1, 3), planes, strict=True):
            both = np.concatenate([waves[plane], waves[plane + 1]], axis=1) @ weights
            responses[plane], responses[plane + 1] = both[:, :units], both[:, units:]
        orders = (_BASIS.T @ responses.reshape(SECTORS, -1)).reshape(responses.shape)
        return _rectify(orders.max(axis=0) + self.weights["mixing_bias"])

    @cached_property
    def _mixing_waves(self) -> list[FloatArray]:
        """The mixing layer over the Fourier basis: (U, H), and (2 U, 2 H) for 1 and 2 turns."""
        mixing = self.weights["mixing_weight"]
        waves = (_BASIS @ mixing.reshape(SECTORS, -1)).reshape(SECTORS, -1, mixing.shape[1])
        planes = [
            np.block([[waves[k], waves[k + 1]], [waves[k + 1], -waves[k]]]) * PLANE_GAIN
            for k in (1, 3)
        ]
        return [waves[0] * MEAN_GAIN, *planes]

    def _layer(self, name: str, values: FloatArray) -> FloatArray:
        result = values @ self.weights[f"{name}_weight"]
        result += self.weights[f"{name}_bias"]
        return result


def _rectify(values: FloatArray) -> FloatArray:
    """Zero in place of what is negative, in place."""
    return np.maximum(values, 0, out=values)


def _gelu(values: FloatArray) -> FloatArray:
    """x times the share of a normal distribution below it (Hendrycks & Gimpel, 1606.08415)."""
    from scipy.special import ndtr

    return values * ndtr(values)
