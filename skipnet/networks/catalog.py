"""Networks from files: weights (.npz) and the card beside them (.json)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skipnet.clouds.formats.arrays import read_archive
from skipnet.networks.model import Model, digest_of
from skipnet.networks.names import SHIPPED, matcher_file, weights_file
from skipnet.networks.numpy_deep import DeepNumpyNetwork
from skipnet.networks.numpy_matcher import NumpyMatcher
from skipnet.networks.numpy_network import SmallNetwork
from skipnet.networks.on_grids import OnGrids
from skipnet.storage import read_json, replacing, write_text
from skipnet.types import FloatArray


def _deep(weights: dict[str, FloatArray], card: dict[str, Any], device: str) -> Model:
    """On the processor NumPy is as fast, and need not be imported."""
    if device == "cpu":
        return DeepNumpyNetwork(weights, card)
    from skipnet.networks.torch_network import TorchNetwork

    return TorchNetwork(weights, card, device)


ARCHITECTURES: dict[str, Callable[[dict[str, FloatArray], dict[str, Any], str], Model]] = {
    SmallNetwork.architecture: lambda weights, card, device: SmallNetwork(weights, card),
    "deep": _deep,
}
"""What makes a network of weights and card on a device, by the card's "architecture"."""

_Network = TypeVar("_Network")
_Makers = Mapping[str, Callable[[dict[str, FloatArray], dict[str, Any], str], _Network]]


def find_network(network: str = SHIPPED, device: str = "cpu") -> Model:
    """A network by its name, "shipped" or another that the package holds, or by its file.

    A file is read once, as long as it stays as it is.

    Args:
        network: name or path.
        device: where a network computes that torch computes: "cpu", "cuda" or "mps".

    Raises:
        ValueError: neither a name nor a file, or a file that holds no such network whole.
        FileNotFoundError: a file without its card.
    """
    path = weights_file(network)
    return _read_once(path.resolve(), path.stat().st_mtime_ns, device)


def find_deep(network: str, option: str, device: str = "cpu") -> OnGrids:
    """As ``find_network``, a deep network.

    Raises:
        ValueError: another one; ``option`` is how the user calls it.
    """
    found = find_network(network, device)
    if not isinstance(found, OnGrids):
        raise ValueError(
            f"{option}={network}: expected a deep network, as train.py experiment=deep"
        )
    return found


def find_matcher(matcher: str, network: Model) -> NumpyMatcher:
    """A matcher by its name, or by its file, for what a deep network describes.

    Raises:
        ValueError: neither its name nor a file, a file that holds no matcher whole, or one that
            learned from what another network describes.
        FileNotFoundError: a file without its card.
    """
    path = matcher_file(matcher)
    found = _read_matcher_once(path.resolve(), path.stat().st_mtime_ns)
    expected = found.card.get("describes")
    if network.digest != expected:
        raise ValueError(
            f"matcher={matcher} learned from what the network {expected} describes, not "
            f"{network.digest}; train one upon it, or take matcher=null"
        )
    return found


@lru_cache(maxsize=8)
def _read_once(path: Path, changed_ns: int, device: str) -> Model:
    return load_network(path, device)


@lru_cache(maxsize=8)
def _read_matcher_once(path: Path, changed_ns: int) -> NumpyMatcher:
    return load_matcher(path)


def rounded(weights: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The float32 weights that a file of float16 gives back."""
    return {name: array.astype(np.float16).astype(np.float32) for name, array in weights.items()}


def save_network(weights: Mapping[str, FloatArray], card: Mapping[str, Any], path: Path) -> None:
    """Write weights, in float16, to ``path`` (.npz) and the card beside them (.json).

    Args:
        weights: of the network.
        card: how it came about, with its "architecture"; the weights' hash is added to it.
        path: of the weights; the folder is made when missing.
    """
    halves = {name: array.astype(np.float16) for name, array in weights.items()}
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **halves)  # type: ignore[arg-type]  # NumPy's own stubs
    signed = {**card, "digest": digest_of(rounded(weights))}
    write_text(path.with_suffix(".json"), json.dumps(signed, indent=2) + "\n")


def load_network(path: Path, device: str = "cpu") -> Model:
    """Read weights and card; see ``find_network``.

    Raises:
        FileNotFoundError: no weights or no card there.
        ValueError: the weights are not those that the card was written for, or not those of its
            architecture.
    """
    return _load(path, ARCHITECTURES, device)


def load_matcher(path: Path) -> NumpyMatcher:
    """Read a matcher's weights and card; see ``load_network``."""
    make = {NumpyMatcher.architecture: lambda weights, card, device: NumpyMatcher(weights, card)}
    return _load(path, make, "cpu")


def _load(path: Path, architectures: _Makers[_Network], device: str) -> _Network:
    """One of these architectures."""
    card_path = path.with_suffix(".json")
    for file in (path, card_path):
        if not file.is_file():
            raise FileNotFoundError(f"no file of the network {file}; python train.py writes one")
    card = read_json(card_path)
    weights = _read_weights(path)
    found, expected = digest_of(weights), card.get("digest")
    if found != expected:
        raise ValueError(
            f"{path} is not whole, or not the file of its card: its weights have the digest "
            f"{found}, the card says {expected}"
        )
    make = architectures.get(str(card.get("architecture")))
    if make is None:
        known = " or ".join(architectures)
        raise ValueError(f"{card_path}: architecture is {card.get('architecture')}, not {known}")
    try:
        return make(weights, card, device)
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path}: not the weights of its architecture: {error}") from error


def _read_weights(path: Path) -> dict[str, FloatArray]:
    arrays = read_archive(path)
    for name, array in arrays.items():
        if array.dtype.kind != "f" or not np.isfinite(array).all():
            raise ValueError(f"{path}: {name} holds {array.dtype}: expected finite numbers")
    return {name: array.astype(np.float32) for name, array in arrays.items()}
