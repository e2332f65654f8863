"""A classifier of feature voxels alone, such as the paper's 125-50-5: weights and their card.

skipnet itself uses the class head of ``skipnet.networks.numpy_network``; this one is its yardstick.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from skipnet.storage import read_json, replacing, write_text
from skipnet.types import FeatureClass, FloatArray

PATCH_SIZE = 125
ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "gelu": nn.GELU}


class PatchNetwork(nn.Module):
    """125 inputs, hidden layers, five outputs; one hidden layer of 50 units is the paper's network.

    The scaling of these inputs belongs to the network and is stored with its weights. What else is
    known of a voxel, beside its 125 cells, joins them after the first hidden layer, as it is.

    Args:
        hidden_sizes: units per hidden layer.
        activation: of the hidden units, "tanh" (MATLAB's tansig) or "gelu".
        dropout: share of the hidden units that training leaves out at random.
        outputs: number of classes.
        beside: further inputs.
        beside_dropout: share of these that training leaves out at random.

    Raises:
        ValueError: no hidden units, or an unknown activation.
    """

    input_offset: torch.Tensor
    input_gain: torch.Tensor

    def __init__(
        self,
        hidden_sizes: Sequence[int] = (50,),
        activation: str = "tanh",
        dropout: float = 0.0,
        outputs: int = len(FeatureClass),
        beside: int = 0,
        beside_dropout: float = 0.0,
    ) -> None:
        super().__init__()
        if not hidden_sizes or min(hidden_sizes) < 1:
            raise ValueError(f"hidden_sizes must name positive layer sizes, got {hidden_sizes}")
        if activation not in ACTIVATIONS:
            raise ValueError(f"activation is {activation!r}; expected {' or '.join(ACTIVATIONS)}")
        inputs = [PATCH_SIZE, hidden_sizes[0] + beside, *hidden_sizes[1:]]
        layers: list[nn.Module] = []
        for size, units in zip(inputs, hidden_sizes, strict=False):
            layers += [nn.Linear(size, units), ACTIVATIONS[activation](), nn.Dropout(dropout)]
        self.layers = nn.Sequential(*layers, nn.Linear(inputs[-1], outputs))
        self.beside_dropout = nn.Dropout(beside_dropout)
        self.register_buffer("input_offset", torch.zeros(PATCH_SIZE))
        self.register_buffer("input_gain", torch.ones(PATCH_SIZE))

    def fit_scaling(self, patches: torch.Tensor, scaling: str = "minmax") -> None:
        """Take offset and gain of every input from (N, 125) training patches.

        Args:
            patches: what the network will be trained on; further columns stay as they are.
            scaling: "minmax" to [-1, 1] as MATLAB's ``mapminmax``, or "standard" to mean 0 and
                standard deviation 1. An input that never changes gets gain 0 either way, which is
                the same as leaving it out (MATLAB's ``removeconstantrows``).

        Raises:
            ValueError: another scaling.
        """
        patches = patches[:, :PATCH_SIZE]
        low, high = patches.amin(dim=0), patches.amax(dim=0)
        if scaling == "minmax":
            offset, unit = (high + low) / 2, (high - low) / 2
        elif scaling == "standard":
            offset, unit = patches.mean(dim=0), patches.std(dim=0, correction=0)
        else:
            raise ValueError(f"scaling is {scaling!r}; expected minmax or standard")
        self.input_offset.copy_(offset)
        self.input_gain.copy_(torch.where(high > low, 1 / unit.clamp_min(1e-6), 0.0))

    def forward(self, patches: torch.Tensor) -> torch.Tensor:
        """(N, 125 + B) inputs to (N, 5) logits; their softmax is the paper's output layer."""
        cells, beside = patches[:, :PATCH_SIZE], patches[:, PATCH_SIZE:]
        units = self.layers[:3]((cells - self.input_offset) * self.input_gain)
        return self.layers[3:](torch.cat([units, self.beside_dropout(beside)], dim=1))


@dataclass(frozen=True)
class Classifier:
    """A trained network and its card."""

    network: PatchNetwork
    card: dict[str, Any]
    """How it came about: layers, kind of patch, configuration, hash of the data, seed, scores."""


def classify(classifier: Classifier, patches: FloatArray) -> FloatArray:
    """Probabilities of the five classes.

    Args:
        classifier: from ``load_classifier``.
        patches: (K, 125) patches of the kind the classifier was trained on.

    Returns:
        (K, 5) float32, columns in the order of ``FeatureClass``; each row sums to 1.

    Raises:
        ValueError: patches of another shape.
    """
    patches = np.asarray(patches, dtype=np.float32)
    if patches.ndim != 2 or patches.shape[1] != PATCH_SIZE:
        raise ValueError(f"patches must be (K, {PATCH_SIZE}), got {patches.shape}")
    with torch.inference_mode():
        logits = classifier.network(torch.from_numpy(patches))
        return torch.softmax(logits, dim=1).numpy()


def round_to_half(network: PatchNetwork) -> PatchNetwork:
    """Round the layers' weights to half precision in place: files half as large, answers alike.

    The network still computes in float32.
    """
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(parameter.half())
    return network


def save_classifier(classifier: Classifier, path: Path) -> None:
    """Write the weights to ``path``, layers in half precision, and the card beside them as JSON.

    What is read back is what was written if the network went through ``round_to_half``.
    """
    layers = dict(classifier.network.named_parameters())
    state = classifier.network.state_dict()
    with replacing(path) as temporary:
        torch.save(
            {name: v.half() if name in layers else v for name, v in state.items()}, temporary
        )
    write_text(path.with_suffix(".json"), json.dumps(classifier.card, indent=2) + "\n")


def load_classifier(path: Path) -> Classifier:
    """Read weights and card.

    Raises:
        FileNotFoundError: no weights or no card there.
        ValueError: the weights do not fit the network that the card describes.
    """
    card_path = path.with_suffix(".json")
    for file in (path, card_path):
        if not file.is_file():
            raise FileNotFoundError(
                f"no classifier file {file}; python train.py experiment=classes writes one"
            )
    card = read_json(card_path)
    try:
        state = torch.load(path, weights_only=True)
        with torch.device("meta"):  # a card of a stranger takes no memory
            network = PatchNetwork(card["hidden_sizes"], card["activation"])
        network.load_state_dict({n: v.float() for n, v in state.items()}, strict=True, assign=True)
    except Exception as error:  # what torch, pickle and zipfile raise has no common base
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path} does not fit the network on its card: {message}") from error
    return Classifier(network.eval(), card)
