"""Networks that torch computes, on any device that it knows."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch

from skipnet.features.grids import GRID_SHAPE, cylinder_grids, turned_over
from skipnet.networks.deep import DeepNetwork
from skipnet.networks.devices import find_device
from skipnet.networks.model import digest_of
from skipnet.networks.numpy_deep import CURVED_SHARE, MAX_KEYPOINTS, NO_CLASSES
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

_CHUNK = 256
"""Voxels that the network reads at a time."""


class TorchNetwork:
    """The deep network at work: a ``Model`` that describes and does not classify.

    Args:
        weights: of ``DeepNetwork``, with the scaling of its inputs.
        card: with the network's "widths".
        device: where to compute: "cpu", "cuda" or "mps".

    Raises:
        ValueError: weights of another network, or no such device here.
    """

    architecture: ClassVar[str] = "deep"
    max_keypoints: ClassVar[int] = MAX_KEYPOINTS
    curved_share: ClassVar[float] = CURVED_SHARE

    def __init__(
        self, weights: dict[str, FloatArray], card: dict[str, Any], device: str = "cpu"
    ) -> None:
        self.card, self.weights, self._device = card, weights, find_device(device)
        with torch.device("meta"):  # a card of a stranger takes no memory
            network = DeepNetwork(**card["widths"])
        tensors = {name: torch.from_numpy(array) for name, array in weights.items()}
        try:
            network.load_state_dict(tensors, strict=True, assign=True)
        except RuntimeError as error:
            raise ValueError(str(error)) from error
        self._network = network.to(self._device).eval()

    @cached_property
    def digest(self) -> str:
        """See ``Model``."""
        return digest_of(self.weights)

    def cut(self, skipmap: SkipMap, rows: IntArray) -> FloatArray:
        """(K, 2, 8, 6, 16, 7) grids around (K,) voxels."""
        return cylinder_grids(skipmap, rows)

    def turned_over(self, patches: FloatArray) -> FloatArray:
        """The grids that the opposite normals would give."""
        return turned_over(patches)

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K, 48) descriptors and (K,) logits of grids; see ``Model``."""
        if patches.shape[1:] != GRID_SHAPE:
            raise ValueError(f"patches must be (K, {GRID_SHAPE}), got {patches.shape}")
        described = np.zeros((len(patches), self._network.output.out_features), np.float32)
        matchable = np.zeros(len(patches), np.float32)
        with torch.inference_mode():
            for start in range(0, len(patches), _CHUNK):
                some = slice(start, start + _CHUNK)
                grids = torch.from_numpy(np.ascontiguousarray(patches[some], dtype=np.float32))
                found = self._network.recognise(self._network(grids.to(self._device)))
                described[some], matchable[some] = (values.cpu().numpy() for values in found)
        return described, matchable

    def classify(self, details: FloatArray, patches: FloatArray) -> FloatArray:
        """Always refused: this network did not learn the classes.

        Raises:
            ValueError: always.
        """
        raise ValueError(NO_CLASSES)
