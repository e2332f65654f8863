"""The deep network in NumPy: what ``networks.deep`` computes, without importing torch.

Importing torch takes longer than describing two scans. The layers are those of ``DeepNetwork``, by
their names there; each is a product of all cells of some voxels with its weights.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from skipnet.features.grids import CHANNELS, GRID_SHAPE, HEIGHTS, RADII, SCALES
from skipnet.networks.on_grids import OnGrids, check_grids
from skipnet.networks.tiles import (
    TILE_SIZE,
    TILES,
    add_across,
    cut_tiles,
    join_sectors,
    list_tiles,
)
from skipnet.types import FloatArray, IntArray

_CHUNK = 32
"""Voxels that are read at a time: what is computed of them stays in the processor's cache."""
_TINY = 1e-5
"""Added to variances, as torch does."""


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
        held, near = list_tiles(grids)
        cells = np.repeat(self._empty_cells, len(grids), axis=0)
        cells[tuple(held.T)] = self._joined(grids, held)
        for block in range(self.card["widths"]["blocks"]):
            cells += self._local(block, cells, near)
        cells = _rectify(self._normalised("norm", cells))
        by_sector = np.ascontiguousarray(cells.transpose(0, 4, 1, 2, 3, 5))
        units = _rectify(self._linear("sector", by_sector.reshape(len(grids), TILES[3], -1)))
        return _rectify(self._linear("around", _neighbouring_sectors(units)).max(axis=1))

    def _joined(self, grids: FloatArray, held: IntArray) -> FloatArray:
        """(M, local): 2 x 2 x 4 scaled cells together, at (M, 5) places of ``list_tiles``."""
        tiles = np.empty((len(held), TILE_SIZE), np.float32)
        scaling = self.weights["input_mean"], self.weights["input_gain"]
        cut_tiles(grids, *scaling, held, tiles)
        return _rectify(self._linear("joining", tiles))

    def _local(self, block: int, cells: FloatArray, near: IntArray) -> FloatArray:
        """(N, 2, 4, 3, 8, local): see ``LocalBlock``. What the first block says differs from what
        it says of an empty grid by what tiles at (R, 5) places of ``list_tiles`` say."""
        if block:  # what the block before said reaches further
            return self._said(block, cells)
        inner_of_empty, said_of_empty = self._said_of_empty
        said = np.repeat(said_of_empty, len(cells), axis=0)
        self._tell(block, self._inner(block, cells, near) - inner_of_empty[near[:, 1]], near, said)
        return said

    def _said(self, block: int, cells: FloatArray) -> FloatArray:
        """(N, 2, 4, 3, 8, local): as ``_local``, of all tiles."""
        said = np.empty_like(cells)
        said[:] = self.weights[f"blocks.{block}.across.bias"]
        every = _every_tile(len(cells))
        self._tell(block, self._inner(block, cells, every), every, said)
        return said

    def _inner(self, block: int, cells: FloatArray, where: IntArray) -> FloatArray:
        """(R, local): what tiles at (R, 5) places and those beside them have to say."""
        normalised = self._normalised(f"blocks.{block}.norm", cells)
        joined = np.empty((len(where), 3 * cells.shape[-1]), np.float32)
        join_sectors(normalised, where, joined)
        return _rectify(self._linear(f"blocks.{block}.around", joined))

    def _tell(self, block: int, inner: FloatArray, where: IntArray, said: FloatArray) -> None:
        """Add what (R, local) tiles at (R, 5) places say to those above, below, in and out."""
        across = inner @ self._across[block]
        add_across(said, where, across.reshape(len(where), 3, 3, -1))

    @cached_property
    def _across(self) -> list[FloatArray]:
        """Per block (local, 9 local) weights: from one tile to its nine neighbours."""
        weights = [
            self.weights[f"blocks.{block}.across.weight"]
            for block in range(self.card["widths"]["blocks"])
        ]
        return [
            one.reshape(len(one), 9, -1).transpose(2, 1, 0).reshape(len(one), -1) for one in weights
        ]

    @cached_property
    def _empty_cells(self) -> FloatArray:
        """(1, 2, 4, 3, 8, local) of a grid in which nothing is."""
        grid = np.zeros((1, *GRID_SHAPE), np.float32)
        return self._joined(grid, _every_tile(1)).reshape(1, *TILES, -1)

    @cached_property
    def _said_of_empty(self) -> tuple[FloatArray, FloatArray]:
        """(2, local) what each scale's tiles have to say in the first block where nothing is, and
        (1, 2, 4, 3, 8, local) what is said then."""
        first_of_each = np.zeros((TILES[0], 5), np.int32)
        first_of_each[:, 1] = np.arange(TILES[0])
        cells = self._empty_cells
        return self._inner(0, cells, first_of_each), self._said(0, cells)

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


def _every_tile(grids: int) -> IntArray:
    """(R, 5) places of all tiles of so many grids, as of ``list_tiles``."""
    return np.argwhere(np.ones((grids, *TILES), np.bool_)).astype(np.int32)


def _rectify(values: FloatArray) -> FloatArray:
    """Zero in place of what is negative, in place."""
    return np.maximum(values, 0, out=values)
