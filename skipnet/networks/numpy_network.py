"""The learned network: what a voxel is, and 32 numbers to recognise it by in another scan.

One network with two heads. What lies 10 and 20 voxels around a voxel, in cylinders about its
surface's axis, gives hidden units; the descriptor reads these alone, the classes read these and the
paper's 125 cells about the voxel itself, on which they live. Whoever only looks for
correspondences never cuts out the latter.

It is small enough for NumPy; torch is needed to train it (``training.networks.cyclic``), not to use
it, and importing torch alone would take longer than describing two scans.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.cylinders import SECTOR_SIZE, SECTORS, cylinder_patches, turned_over
from skipnet.features.patches import PATCH_SIZE
from skipnet.networks.model import digest_of, sentence
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

_CLASSES = 5
_ROOT_HALF = 0.5**0.5
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


@dataclass(frozen=True, repr=False)
class SmallNetwork:
    """The small network at work: a ``Model``.

    Raises:
        ValueError: other weights than its own.
    """

    architecture: ClassVar[str] = "small"
    max_keypoints: ClassVar[int] = 2000
    """More find few further correspondences and cost as much again."""
    curved_share: ClassVar[float] = 1.0

    weights: dict[str, FloatArray]
    """Per layer (inputs, units) weights and (units,) biases, float32; those of the class head may
    be missing."""
    card: dict[str, Any]
    """See ``Model``."""

    def __post_init__(self) -> None:
        shared, head = (
            {f"{layer}_{kind}" for layer in layers for kind in ("weight", "bias")}
            for layers in (SHARED_LAYERS, CLASS_LAYERS)
        )
        if set(self.weights) not in (shared, shared | head):
            expected = sorted(shared | head)
            raise ValueError(f"weights {sorted(self.weights)}, expected {expected}")
        nothing = np.zeros((1, SECTORS, SECTOR_SIZE), np.float32)
        try:  # sizes that do not fit each other are found now rather than in the middle of a run
            described, matchable = self.read(nothing)
            fits = described.ndim == 2 and described.size > 0 and matchable.shape == (1,)
            if fits and set(self.weights) > shared:
                details = np.zeros((1, PATCH_SIZE), np.float32)
                fits = self.classify(details, nothing).shape == (1, _CLASSES)
        except (ValueError, IndexError) as error:
            raise ValueError(f"layers that do not fit each other: {error}") from error
        if not fits:
            raise ValueError("layers of other sizes than those of this network")

    @cached_property
    def digest(self) -> str:
        """See ``Model``."""
        return digest_of(self.weights)

    def __repr__(self) -> str:
        """Not its weights."""
        return f"<{type(self).__name__} {sentence(self.digest, self.card)}>"

    def cut(self, skipmap: SkipMap, rows: IntArray) -> FloatArray:
        """(K, 5, 100) cylinders around (K,) voxels."""
        return cylinder_patches(skipmap, rows)

    def turned_over(self, patches: FloatArray) -> FloatArray:
        """The (K, 5, 100) patches that the opposite normals would give."""
        return turned_over(patches)

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K, 32) descriptors and (K,) logits of (K, 5, 100) patches; see ``Model``."""
        hidden = self.hidden(patches)
        described = self._layer("output", hidden)
        described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
        return described, self._layer("matchable", hidden)[:, 0]

    def classify(self, details: FloatArray, patches: FloatArray) -> FloatArray:
        """(K, 5) probabilities from (K, 125) details and (K, 5, 100) patches; see ``Model``."""
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
    result = np.empty(values.shape, values.dtype)
    _weigh_by_normal(values.ravel(), result.reshape(-1))
    return result


@compiled
def _weigh_by_normal(values: FloatArray, result: FloatArray) -> None:
    """SciPy's ``ndtr`` does it too, and takes 0.12 s to import."""
    for k in range(len(values)):
        result[k] = values[k] * (0.5 * math.erfc(-values[k] * _ROOT_HALF))
