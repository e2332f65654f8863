"""The matcher in NumPy: what ``networks.matcher`` computes, without importing torch."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from skipnet.networks.model import digest_of, sentence
from skipnet.networks.relations import RELATION_UNITS, RELATIONS, relations
from skipnet.networks.tokens import Tokens
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.types import FloatArray

_CHUNK = 32
"""Keypoints whose relations to all are read at a time: they stay in the processor's cache."""
_TINY = 1e-5
"""Added to variances, as torch does."""


class NumpyMatcher:
    """The matcher at work.

    Args:
        weights: of ``MatcherNetwork``.
        card: with the network's "widths".

    Raises:
        ValueError: weights of another network.
    """

    architecture: ClassVar[str] = "matcher"

    def __init__(self, weights: dict[str, FloatArray], card: dict[str, Any]) -> None:
        self.weights, self.card = weights, card
        expected = matcher_shapes(**card["widths"])
        found = {name: array.shape for name, array in weights.items()}
        if found != expected:
            raise ValueError(f"weights {found}, expected {expected}")
        self._layers = [
            _Layer(weights, f"layers.{number}", card["widths"]["heads"])
            for number in range(card["widths"]["layers"])
        ]

    @cached_property
    def digest(self) -> str:
        """Hash of its weights (``digest_of``)."""
        return digest_of(self.weights)

    def __repr__(self) -> str:
        """Not its weights."""
        return f"<{type(self).__name__} {sentence(self.digest, self.card)}>"

    @one_blas_thread
    def match(self, source: Tokens, target: Tokens, oriented: bool) -> FloatArray:
        """How likely keypoints of two scans are one place.

        Args:
            source: K tokens.
            target: L tokens; with both signs of their axes where these are not known.
            oriented: whether the axes of both look to their sensors' sides.

        Returns:
            (K, L) float32 log probabilities: each takes the other for it, and both have a partner.
        """
        scans = (source, target)
        described = [self._described(scan) for scan in scans]
        tokens = [
            _linear(self.weights, "joining", _normalised(self.weights, "norm", scan.units))
            for scan in scans
        ]
        related = side_by_side(lambda scan: self._related(scan, oriented), scans)
        for number, layer in enumerate(self._layers):
            biases = [bias[number] for _, bias in related]
            tables = [table for table, _ in related]
            tokens = layer.hear_other(*side_by_side(layer.hear_own, tokens, tables, biases))
        places = [_linear(self.weights, "place", one) for one in tokens]
        alike = (self.weights["sharpness"] * described[0]) @ described[1].T
        alike += (places[0] / np.sqrt(np.float32(places[0].shape[1]))) @ places[1].T
        partners = [_log_sigmoid(_linear(self.weights, "partner", one)[:, 0]) for one in tokens]
        return _both_ways(alike) + partners[0][:, None] + partners[1][None]

    def _described(self, scan: Tokens) -> FloatArray:
        """(K, D) descriptors of length 1."""
        described = _linear(self.weights, "output", scan.units)
        described /= np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12)
        return described

    def _related(self, scan: Tokens, oriented: bool) -> tuple[FloatArray, FloatArray]:
        """(K, K, 7) relations, and (layers, heads, K, K) how much these speak for attention."""
        count, widths = len(scan.units), self.card["widths"]
        table = np.empty((count, count, RELATIONS), np.float32)
        relations(scan.places_voxels, scan.axes, oriented, table)
        bias = np.empty((widths["layers"] * widths["heads"], count, count), np.float32)
        for start in range(0, count, _CHUNK):
            some = table[start : start + _CHUNK].reshape(-1, RELATIONS)
            inner = _linear(self.weights, "relation_inner", some)
            outer = _linear(self.weights, "relation_outer", np.maximum(inner, 0, out=inner))
            bias[:, start : start + _CHUNK] = outer.T.reshape(len(bias), -1, count)
        return table, bias.reshape(widths["layers"], widths["heads"], count, count)


class _Layer:
    """See ``networks.matcher.Layer``."""

    def __init__(self, weights: dict[str, FloatArray], name: str, heads: int) -> None:
        self._heads = heads
        self._weights = {
            key.removeprefix(f"{name}."): array
            for key, array in weights.items()
            if key.startswith(f"{name}.")
        }

    def hear_own(self, tokens: FloatArray, related: FloatArray, bias: FloatArray) -> FloatArray:
        """(K, W) tokens, (K, K, 7) relations and (heads, K, K) what these make of them."""
        weights = self._weights
        query, key, value = self._by_head("own", _normalised(weights, "own_norm", tokens), 3)
        attention = _softmax(_likeness(query, key) + bias, axis=2)
        lies = np.matmul(attention.transpose(1, 0, 2), related).reshape(len(tokens), -1)
        said = np.concatenate([_joined(attention @ value), lies], axis=1)
        return self._heard("own_hearing", tokens, _linear(weights, "own_said", said))

    def hear_other(self, source: FloatArray, target: FloatArray) -> list[FloatArray]:
        """(K, W) and (L, W) tokens to the same."""
        (key_s, value_s), (key_t, value_t) = (
            self._by_head("other", _normalised(self._weights, "other_norm", tokens), 2)
            for tokens in (source, target)
        )
        alike = _likeness(key_s, key_t)
        attentions = _softmax(alike, axis=2), _softmax(alike, axis=1).transpose(0, 2, 1)

        def hear(tokens: FloatArray, attention: FloatArray, value: FloatArray) -> FloatArray:
            """(K, W) tokens and what they hear from others to the same."""
            said = _linear(self._weights, "other_said", _joined(attention @ value))
            return self._heard("other_hearing", tokens, said)

        return side_by_side(hear, (source, target), attentions, (value_t, value_s))

    def _heard(self, name: str, tokens: FloatArray, said: FloatArray) -> FloatArray:
        """See ``networks.matcher.Hearing``."""
        both = _normalised(self._weights, f"{name}.norm", np.concatenate([tokens, said], axis=1))
        inner = _linear(self._weights, f"{name}.inner", both)
        return tokens + _linear(self._weights, f"{name}.outer", np.maximum(inner, 0, out=inner))

    def _by_head(self, name: str, tokens: FloatArray, parts: int) -> FloatArray:
        """(parts, heads, K, W / heads) of (K, W) tokens."""
        values = _linear(self._weights, name, tokens)
        by_head = values.reshape(len(tokens), parts, self._heads, -1).transpose(1, 2, 0, 3)
        return np.ascontiguousarray(by_head)


def matcher_shapes(
    units: int, output: int, width: int, heads: int, layers: int
) -> dict[str, tuple[int, ...]]:
    """The shape of each of ``MatcherNetwork``'s weights."""
    linear: dict[str, tuple[int, int]] = {
        "joining": (width, units),
        "output": (output, units),
        "relation_inner": (RELATION_UNITS, RELATIONS),
        "relation_outer": (layers * heads, RELATION_UNITS),
        "place": (width, width),
        "partner": (1, width),
    }
    norms = {"norm": units}
    for number in range(layers):
        layer = f"layers.{number}"
        linear[f"{layer}.own"] = (3 * width, width)
        linear[f"{layer}.own_said"] = (width, width + heads * RELATIONS)
        linear[f"{layer}.other"] = (2 * width, width)
        linear[f"{layer}.other_said"] = (width, width)
        norms |= {f"{layer}.own_norm": width, f"{layer}.other_norm": width}
        for hearing in (f"{layer}.own_hearing", f"{layer}.other_hearing"):
            linear[f"{hearing}.inner"] = (2 * width, 2 * width)
            linear[f"{hearing}.outer"] = (width, 2 * width)
            norms[f"{hearing}.norm"] = 2 * width
    shapes: dict[str, tuple[int, ...]] = {"sharpness": (1,)}
    shapes |= {f"{name}.weight": shape for name, shape in linear.items()}
    shapes |= {f"{name}.bias": shape[:1] for name, shape in linear.items()}
    return shapes | {f"{n}.{kind}": (w,) for n, w in norms.items() for kind in ("weight", "bias")}


def _linear(weights: dict[str, FloatArray], name: str, values: FloatArray) -> FloatArray:
    """(K, ...) of (K, ...)."""
    product = values @ weights[f"{name}.weight"].T
    product += weights[f"{name}.bias"]
    return product


def _normalised(weights: dict[str, FloatArray], name: str, values: FloatArray) -> FloatArray:
    """Mean 0 and deviation 1 of each row, then the layer's own."""
    centred = values - values.mean(axis=1, keepdims=True)
    variance = np.einsum("kc,kc->k", centred, centred) / values.shape[1]
    centred *= (1 / np.sqrt(variance + _TINY))[:, None]
    centred *= weights[f"{name}.weight"]
    centred += weights[f"{name}.bias"]
    return centred


def _likeness(first: FloatArray, second: FloatArray) -> FloatArray:
    """(heads, K, C) and (heads, L, C) to (heads, K, L)."""
    return (first / np.sqrt(np.float32(first.shape[2]))) @ second.transpose(0, 2, 1)


def _softmax(values: FloatArray, axis: int) -> FloatArray:
    """Exponentials that sum to 1 along an axis."""
    raised = values - values.max(axis=axis, keepdims=True)
    np.exp(raised, out=raised)
    raised /= raised.sum(axis=axis, keepdims=True)
    return raised


def _both_ways(alike: FloatArray) -> FloatArray:
    """(K, L) sums of the logarithms of both softmaxes."""
    return 2 * alike - _log_sums(alike, 0) - _log_sums(alike, 1)


def _log_sums(values: FloatArray, axis: int) -> FloatArray:
    """Logarithms of the sums of exponentials along an axis, which stays."""
    most = values.max(axis=axis, keepdims=True)
    return most + np.log(np.exp(values - most).sum(axis=axis, keepdims=True))


def _log_sigmoid(values: FloatArray) -> FloatArray:
    return -np.logaddexp(np.float32(0), -values)


def _joined(by_head: FloatArray) -> FloatArray:
    """(heads, K, C) to (K, heads C)."""
    return by_head.transpose(1, 0, 2).reshape(by_head.shape[1], -1)
