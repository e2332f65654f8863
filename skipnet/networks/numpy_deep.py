"""The deep network in NumPy: what ``networks.deep`` computes, without importing torch.

Importing torch takes longer than describing two scans. The layers are those of ``DeepNetwork``, by
their names there; each is a product of all cells of some voxels with its weights.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from skipnet.features.grids import (
    CHANNELS,
    HEIGHTS,
    RADII,
    SCALES,
    SECTORS,
)
from skipnet.networks.on_grids import OnGrids, check_grids
from skipnet.types import FloatArray

_CHUNK = 32
"""Voxels that are read at a time: what is computed of them stays in the processor's cache."""
_TINY = 1e-5
"""Added to variances, as torch does."""
_JOINED = (SCALES, HEIGHTS // 2, RADII // 2, SECTORS // 2)
"""Scales, heights, radii and sectors once 2 x 2 x 2 cells are joined."""


class DeepNumpyNetwork(OnGrids):
    """The deep network at work on the processor: a ``Model`` that describes and does not classify.

    Args:
        weights: of ``DeepNetwork``, with the scaling of its inputs.
        card: with the network's "widths".

    Raises:
        ValueError: weights of another network.
    """

    def __init__(self, weights: dict[str, FloatArray], card: dict[str, Any]) -> None:
        self.weights, self.card = weights, card
        expected = shapes_of(**card["widths"])
        found = {name: array.shape for name, array in weights.items()}
        if found != expected:
            raise ValueError(f"weights {found}, expected {expected}")

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K, 48) descriptors and (K,) logits of grids; see ``Model``."""
        hidden = self.units(patches)
        described = self._linear("output", hidden)
        described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
        return described, self._linear("matchable", hidden)[:, 0]

    def units(self, patches: FloatArray) -> FloatArray:
        """See ``OnGrids``."""
        check_grids(patches)
        hidden = np.empty((len(patches), self.card["widths"]["hidden"]), np.float32)
        for start in range(0, len(patches), _CHUNK):
            some = slice(start, start + _CHUNK)
            hidden[some] = self._hidden(patches[some].astype(np.float32, copy=False))
        return hidden

    def _hidden(self, grids: FloatArray) -> FloatArray:
        """(N, hidden) units of (N, 2, 8, 6, 16, 7) grids."""
        cells = self._joined(grids)
        for block in range(self.card["widths"]["blocks"]):
            cells += self._local(f"blocks.{block}", cells)
        cells = _rectify(self._normalised("norm", cells))
        by_sector = np.ascontiguousarray(cells.transpose(0, 4, 1, 2, 3, 5))
        units = _rectify(self._linear("sector", by_sector.reshape(len(grids), _JOINED[3], -1)))
        return _rectify(self._linear("around", _neighbouring_sectors(units)).max(axis=1))

    def _joined(self, grids: FloatArray) -> FloatArray:
        """(N, 2, 4, 3, 8, local): 2 x 2 x 4 scaled cells together, sectors overlapping."""
        scaled = (grids - self._mean) * self._gain
        scales, heights, radii, sectors = _JOINED
        wide = np.concatenate([scaled[..., -1:, :], scaled, scaled[..., :1, :]], axis=-2)
        tiles = np.empty((len(grids), scales, heights, radii, sectors, 2, 2, 4 * CHANNELS), "f4")
        rows = wide.reshape(len(grids), scales, heights, 2, radii, 2, -1)
        for sector in range(sectors):
            own = slice(2 * CHANNELS * sector, CHANNELS * (2 * sector + 4))
            tiles[:, :, :, :, sector] = rows[..., own].transpose(0, 1, 2, 4, 3, 5, 6)
        return _rectify(self._linear("joining", tiles.reshape(*tiles.shape[:5], -1)))

    def _local(self, block: str, cells: FloatArray) -> FloatArray:
        """(N, 2, 4, 3, 8, local): see ``LocalBlock``."""
        near = _neighbouring_sectors(self._normalised(f"{block}.norm", cells))
        inner = _rectify(self._linear(f"{block}.around", near))
        said = np.empty_like(cells)
        said[:] = self.weights[f"{block}.across.bias"]
        across = self.weights[f"{block}.across.weight"]
        parts = across.reshape(len(across), 3, 3, -1)
        heights, radii = _JOINED[1:3]
        for up in range(3):
            for out in range(3):
                there = inner @ parts[:, up, out].T
                to_h, from_h = _overlap(1 - up, heights)
                to_r, from_r = _overlap(1 - out, radii)
                said[:, :, to_h, to_r] += there[:, :, from_h, from_r]
        return said

    def _linear(self, name: str, values: FloatArray) -> FloatArray:
        flat = values.reshape(-1, values.shape[-1]) @ self.weights[f"{name}.weight"].T
        flat += self.weights[f"{name}.bias"]
        return flat.reshape(*values.shape[:-1], flat.shape[1])

    def _normalised(self, name: str, values: FloatArray) -> FloatArray:
        """Mean 0 and deviation 1 over the channels, then the layer's own."""
        centred = values - values.mean(axis=-1, keepdims=True)
        variance = np.einsum("...c,...c->...", centred, centred) / values.shape[-1]
        centred *= (1 / np.sqrt(variance + _TINY))[..., None]
        centred *= self.weights[f"{name}.weight"]
        centred += self.weights[f"{name}.bias"]
        return centred

    @cached_property
    def _mean(self) -> FloatArray:
        return self.weights["input_mean"][:, None, None, None]

    @cached_property
    def _gain(self) -> FloatArray:
        return self.weights["input_gain"][:, None, None, None]


def shapes_of(local: int, hidden: int, output: int, blocks: int) -> dict[str, tuple[int, ...]]:
    """The shape of each of ``DeepNetwork``'s weights."""
    layers: dict[str, tuple[int, ...]] = {
        "joining": (local, 16 * CHANNELS),
        "sector": (hidden, SCALES * HEIGHTS // 2 * (RADII // 2) * local),
        "around": (hidden, 3 * hidden),
        "output": (output, hidden),
        "matchable": (1, hidden),
    }
    norms = ["norm"]
    for block in range(blocks):
        layers[f"blocks.{block}.around"] = (local, 3 * local)
        layers[f"blocks.{block}.across"] = (local, 9 * local)
        norms.append(f"blocks.{block}.norm")
    shapes = {f"{name}.weight": shape for name, shape in layers.items()}
    shapes |= {f"{name}.bias": shape[:1] for name, shape in layers.items()}
    shapes |= {f"{name}.{kind}": (local,) for name in norms for kind in ("weight", "bias")}
    return shapes | dict.fromkeys(("input_mean", "input_gain"), (SCALES, CHANNELS))


def _neighbouring_sectors(cells: FloatArray) -> FloatArray:
    """(..., A, C) to (..., A, 3 C): each sector with the ones before and behind it."""
    return np.concatenate([np.roll(cells, 1, -2), cells, np.roll(cells, -1, -2)], axis=-1)


def _overlap(shift: int, count: int) -> tuple[slice, slice]:
    """Of ``count`` places moved on by a shift: where they come to lie, and which they are."""
    return slice(max(shift, 0), count + min(shift, 0)), slice(max(-shift, 0), count - max(shift, 0))


def _rectify(values: FloatArray) -> FloatArray:
    """Zero in place of what is negative, in place."""
    return np.maximum(values, 0, out=values)
