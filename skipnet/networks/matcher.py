"""The matcher in torch: which keypoints of two scans show the same place, seen together.

A descriptor sees what lies around one keypoint. Here each keypoint hears of the others of its own
scan, and how they lie to it (self-attention that knows distances and angles, which no motion
changes; after GeoTransformer, Qin et al., CVPR 2022), then of those of the other scan that it may
be (cross-attention, one table of likeness for both directions as in LightGlue, Lindenberger et al.,
ICCV 2023). What comes out is how likely each two are the same place, and each has a partner at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import nn
from torch.nn.functional import logsigmoid, normalize

from skipnet.networks.relations import (
    APART_VOXELS,
    FADING_VOXELS,
    NEAR_VOXELS,
    RELATION_UNITS,
    RELATIONS,
)
from skipnet.networks.tokens import Tokens

TwoScans = Sequence[torch.Tensor]
"""Of the source, and of the target."""


def relations(tokens: Tokens, oriented: bool) -> torch.Tensor:
    """(K, K, 7) as ``networks.relations``."""
    places, axes = tokens.places_voxels, tokens.axes
    line = places[None] - places[:, None]
    far = line.norm(dim=-1)
    apart = far > APART_VOXELS
    line = line * (apart / far.clamp(min=1e-6))[..., None]
    own = torch.einsum("ijc,ic->ij", line, axes)
    others = torch.einsum("ijc,jc->ij", line, axes)
    cosine = axes @ axes.T
    angles = [own, others, cosine] if oriented else [own.abs(), others.abs(), cosine.abs()]
    fading = [torch.exp(-far / reach) for reach in FADING_VOXELS]
    return torch.stack([torch.log1p(far / NEAR_VOXELS), *fading, *angles], dim=-1)


class Hearing(nn.Module):
    """What a keypoint makes of what it hears."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(2 * width)
        self.inner = nn.Linear(2 * width, 2 * width)
        self.outer = nn.Linear(2 * width, width)
        nn.init.zeros_(self.outer.weight)
        nn.init.zeros_(self.outer.bias)

    def forward(self, tokens: torch.Tensor, heard: torch.Tensor) -> torch.Tensor:
        """(K, W) and (K, W) to (K, W)."""
        both = self.norm(torch.cat([tokens, heard], dim=1))
        return tokens + self.outer(torch.relu(self.inner(both)))


class Layer(nn.Module):
    """Each keypoint hears of those of its own scan, then of those of the other."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.own_norm = nn.LayerNorm(width)
        self.own = nn.Linear(width, 3 * width)
        self.own_said = nn.Linear(width + heads * RELATIONS, width)
        self.own_hearing = Hearing(width)
        self.other_norm = nn.LayerNorm(width)
        self.other = nn.Linear(width, 2 * width)
        self.other_said = nn.Linear(width, width)
        self.other_hearing = Hearing(width)

    def forward(
        self, tokens: TwoScans, related: TwoScans, biases: TwoScans
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """(K, W) tokens of the source and (L, W) of the target to the same; see ``_hear_own``."""
        source, target = (
            self._hear_own(*of_scan) for of_scan in zip(tokens, related, biases, strict=True)
        )
        return self._hear_other(source, target)

    def _hear_own(
        self, tokens: torch.Tensor, related: torch.Tensor, bias: torch.Tensor
    ) -> torch.Tensor:
        """(K, W) tokens, (K, K, 7) relations and (heads, K, K) what these make of them."""
        query, key, value = self._by_head(self.own(self.own_norm(tokens)), 3)
        attention = _likeness(query, key).add(bias).softmax(dim=-1)
        lies = torch.einsum("hij,ijr->ihr", attention, related).flatten(1)
        said = torch.cat([_joined(attention @ value), lies], dim=1)
        return self.own_hearing(tokens, self.own_said(said))

    def _hear_other(
        self, source: torch.Tensor, target: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """(K, W) and (L, W) tokens to the same."""
        (key_s, value_s), (key_t, value_t) = (
            self._by_head(self.other(self.other_norm(tokens)), 2) for tokens in (source, target)
        )
        alike = _likeness(key_s, key_t)
        to_s = _joined(alike.softmax(dim=2) @ value_t)
        to_t = _joined(alike.softmax(dim=1).transpose(1, 2) @ value_s)
        return (
            self.other_hearing(source, self.other_said(to_s)),
            self.other_hearing(target, self.other_said(to_t)),
        )

    def _by_head(self, values: torch.Tensor, parts: int) -> torch.Tensor:
        """(K, parts W) to (parts, heads, K, W / heads)."""
        return values.unflatten(1, (parts, self.heads, -1)).permute(1, 2, 0, 3)


class MatcherNetwork(nn.Module):
    """Tokens of two scans to log probabilities that they show one place.

    Args:
        units: of the deep network that describes the keypoints.
        output: numbers of its descriptors.
        width: of a token.
        heads: ways to attend to others, side by side.
        layers: one after the other.
    """

    def __init__(
        self, units: int = 192, output: int = 48, width: int = 96, heads: int = 4, layers: int = 3
    ) -> None:
        super().__init__()
        self.widths = {
            "units": units,
            "output": output,
            "width": width,
            "heads": heads,
            "layers": layers,
        }
        self.norm = nn.LayerNorm(units)
        self.joining = nn.Linear(units, width)
        self.output = nn.Linear(units, output)
        self.sharpness = nn.Parameter(torch.tensor([1 / 0.07]))
        self.relation_inner = nn.Linear(RELATIONS, RELATION_UNITS)
        self.relation_outer = nn.Linear(RELATION_UNITS, layers * heads)
        self.layers = nn.ModuleList([Layer(width, heads) for _ in range(layers)])
        self.place = nn.Linear(width, width)
        self.partner = nn.Linear(width, 1)
        nn.init.normal_(self.place.weight, std=0.04)

    def forward(
        self, source: Tokens, target: Tokens, oriented: bool
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See ``matches``: (K, L) logits of two being one place, (K,) and (L,) of having any."""
        described = [normalize(self.output(scan.units), dim=1) for scan in (source, target)]
        tokens = [self.joining(self.norm(scan.units)) for scan in (source, target)]
        related = [relations(scan, oriented) for scan in (source, target)]
        biases = [
            self.relation_outer(torch.relu(self.relation_inner(one)))
            .permute(2, 0, 1)
            .unflatten(0, (len(self.layers), -1))
            for one in related
        ]
        for number, layer in enumerate(self.layers):
            tokens = layer(tokens, related, [bias[number] for bias in biases])
        places = [self.place(one) for one in tokens]
        alike = self.sharpness * (described[0] @ described[1].T)
        alike = alike + places[0] @ places[1].T / math.sqrt(places[0].shape[1])
        return alike, *(self.partner(one)[:, 0] for one in tokens)


def matches(alike: torch.Tensor, partner_s: torch.Tensor, partner_t: torch.Tensor) -> torch.Tensor:
    """(K, L) log probabilities that two keypoints are one place: both take each other for it, and
    both have a partner at all."""
    either = alike.log_softmax(dim=1) + alike.log_softmax(dim=0)
    return either + logsigmoid(partner_s)[:, None] + logsigmoid(partner_t)[None]


def _likeness(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """(heads, K, C) and (heads, L, C) to (heads, K, L)."""
    return first @ second.transpose(1, 2) / math.sqrt(first.shape[-1])


def _joined(by_head: torch.Tensor) -> torch.Tensor:
    """(heads, K, C) to (K, heads C)."""
    return by_head.transpose(0, 1).flatten(1)
