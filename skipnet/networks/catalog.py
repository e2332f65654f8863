"""Networks by name: the shipped weights, loading and saving."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from skipnet.networks.numpy_network import CLASS_LAYERS, SHARED_LAYERS, Descriptor
from skipnet.storage import replacing, write_text
from skipnet.types import FloatArray

SHIPPED_WEIGHTS = Path(__file__).parent / "weights" / "descriptor.npz"


def rounded(weights: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """The float32 weights that a file of float16 gives back."""
    return {name: array.astype(np.float16).astype(np.float32) for name, array in weights.items()}


def save_descriptor(descriptor: Descriptor, path: Path) -> None:
    """Write the weights, in float16, to ``path`` (.npz) and the card beside them (.json)."""
    halves = {name: array.astype(np.float16) for name, array in descriptor.weights.items()}
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **halves)  # type: ignore[arg-type]  # NumPy's own stubs
    write_text(path.with_suffix(".json"), json.dumps(descriptor.card, indent=2) + "\n")


def load_descriptor(path: Path = SHIPPED_WEIGHTS) -> Descriptor:
    """Read weights and card, by default the ones that ship with the package.

    Raises:
        FileNotFoundError: no weights or no card there.
        ValueError: the file holds other weights than the network's.
    """
    card_path = path.with_suffix(".json")
    for file in (path, card_path):
        if not file.is_file():
            raise FileNotFoundError(f"no file of the network {file}; python train.py writes one")
    with np.load(path, allow_pickle=False) as arrays:
        weights = {name: arrays[name].astype(np.float32) for name in arrays.files}
    expected = {
        f"{layer}_{kind}" for layer in SHARED_LAYERS + CLASS_LAYERS for kind in ("weight", "bias")
    }
    if set(weights) != expected:
        raise ValueError(f"{path} holds {sorted(weights)}, expected {sorted(expected)}")
    return Descriptor(weights, json.loads(card_path.read_text()))
