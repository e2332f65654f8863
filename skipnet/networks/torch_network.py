"""Networks that torch computes, on any device that it knows."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from skipnet.networks.deep import DeepNetwork
from skipnet.networks.devices import find_device
from skipnet.networks.on_grids import OnGrids, check_grids
from skipnet.types import FloatArray

_CHUNK = 256
"""Voxels that the network reads at a time."""


class TorchNetwork(OnGrids):
    """The deep network at work: a ``Model`` that describes and does not classify.

    Args:
        weights: of ``DeepNetwork``, with the scaling of its inputs.
        card: with the network's "widths".
        device: where to compute: "cpu", "cuda" or "mps".

    Raises:
        ValueError: weights of another network, or no such device here.
    """

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

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K, 48) descriptors and (K,) logits of grids; see ``Model``."""
        with torch.inference_mode():
            found = self._network.recognise(self._units(patches))
        described, matchable = (values.cpu().numpy() for values in found)
        return described, matchable

    def units(self, patches: FloatArray) -> FloatArray:
        """See ``OnGrids``."""
        with torch.inference_mode():
            return self._units(patches).cpu().numpy()

    def _units(self, patches: FloatArray) -> torch.Tensor:
        """(K, hidden) on the network's device."""
        check_grids(patches)
        units = torch.zeros(len(patches), self._network.widths["hidden"], device=self._device)
        for start in range(0, len(patches), _CHUNK):
            some = slice(start, start + _CHUNK)
            grids = torch.from_numpy(np.ascontiguousarray(patches[some], dtype=np.float32))
            units[some] = self._network(grids.to(self._device))
        return units
