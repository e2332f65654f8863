"""The descriptor's network in torch, and the losses that shape it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy, normalize

from skipnet.features.cylinders import SECTOR_SIZE, SECTORS
from skipnet.learning.descriptor import LAYERS
from skipnet.types import FloatArray

_MASKED = -1e4


@dataclass(frozen=True)
class Widths:
    """Units of the network's layers."""

    sector: int = 48
    """What a sector is summed up in."""
    hidden: int = 128
    output: int = 32
    """Numbers of a descriptor."""


class DescriptorNetwork(nn.Module):
    """The network of ``skipnet.learning.descriptor.Descriptor`` in torch.

    Args:
        widths: units of its layers.
    """

    input_mean: torch.Tensor
    input_gain: torch.Tensor

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        self.sector = nn.Linear(SECTOR_SIZE, widths.sector)
        self.mixing = nn.Linear(SECTORS * widths.sector, widths.hidden)
        self.output = nn.Linear(widths.hidden, widths.output)
        self.matchable = nn.Linear(widths.hidden, 1)
        self.register_buffer("input_mean", torch.zeros(SECTOR_SIZE))
        self.register_buffer("input_gain", torch.ones(SECTOR_SIZE))

    def fit_scaling(self, patches: torch.Tensor) -> None:
        """Bring each input to mean 0 and deviation 1 over (N, 5, 50) patches and all sectors."""
        self.input_mean.copy_(patches.mean(dim=(0, 1)))
        self.input_gain.copy_(1 / (patches.std(dim=(0, 1)) + 1e-2))

    def forward(self, patches: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, 5, 50) patches to (N, D) descriptors of length 1 and (N,) logits of matchability.

        The matchability takes the hidden units as they are: learning it does not change them.
        """
        sectors = torch.relu(self.sector((patches - self.input_mean) * self.input_gain))
        orders = [self.mixing(sectors.roll(turn, 1).flatten(1)) for turn in range(SECTORS)]
        hidden = torch.relu(torch.stack(orders).amax(dim=0))
        return normalize(self.output(hidden), dim=1), self.matchable(hidden.detach())[:, 0]

    def arrays(self) -> dict[str, FloatArray]:
        """The weights as ``Descriptor`` takes them, the scaling of the inputs folded in."""
        weights: dict[str, FloatArray] = {}
        for name in LAYERS:
            layer: nn.Linear = getattr(self, name)
            weights[f"{name}_weight"] = layer.weight.detach().numpy().T.copy()
            weights[f"{name}_bias"] = layer.bias.detach().numpy().copy()
        weights["sector_weight"] *= self.input_gain.numpy()[:, None]
        weights["sector_bias"] -= self.input_mean.numpy() @ weights["sector_weight"]
        return weights


@dataclass(frozen=True)
class Similarities:
    """How alike the descriptors of one batch are, in units of the temperature."""

    across: torch.Tensor
    """(N, N) source to target; what is neither the same place nor a different one is masked."""
    within_s: torch.Tensor
    """(N, N) source to source, different places only."""
    within_t: torch.Tensor
    """(N, N) target to target, different places only."""

    @staticmethod
    def of(
        source: torch.Tensor, target: torch.Tensor, far: torch.Tensor, temperature: float
    ) -> Similarities:
        """Compare N places with each other.

        Args:
            source: (N, D) descriptors of length 1 ...
            target: (N, D) ... and of the same places in the other scan.
            far: (N, N) bool, which places count as different; never a place and itself.
            temperature: cosine similarity that changes the odds e-fold.
        """
        itself = torch.eye(len(source), dtype=torch.bool)
        return Similarities(
            (source @ target.T / temperature).masked_fill(~(far | itself), _MASKED),
            (source @ source.T / temperature).masked_fill(~far, _MASKED),
            (target @ target.T / temperature).masked_fill(~far, _MASKED),
        )


def contrastive_loss(alike: Similarities) -> torch.Tensor:
    """InfoNCE (van den Oord et al., arXiv 1807.03748) both ways, with negatives from both scans.

    Returns:
        Mean over both directions of -log of the share that the true partner has; 0 is perfect.
    """
    truth = torch.arange(len(alike.across))
    forward = cross_entropy(torch.cat([alike.across, alike.within_s], dim=1), truth)
    backward = cross_entropy(torch.cat([alike.across.T, alike.within_t], dim=1), truth)
    return (forward + backward) / 2


def hardest_loss(alike: Similarities, margin: float = 4.0) -> torch.Tensor:
    """Hinge on the most similar wrong place alone (Choy et al., FCGF, ICCV 2019), both ways.

    Args:
        alike: the batch.
        margin: lead over it, in units of the temperature, that is enough.

    Returns:
        Mean lead that is missing; 0 is perfect.
    """
    right = alike.across.diagonal()
    others = alike.across - torch.diag(torch.full_like(right, np.inf))
    wrong_s = torch.maximum(others.amax(dim=1), alike.within_s.amax(dim=1))
    wrong_t = torch.maximum(others.amax(dim=0), alike.within_t.amax(dim=1))
    return (torch.relu(wrong_s + margin - right) + torch.relu(wrong_t + margin - right)).mean() / 2


def matchability_loss(
    logits_s: torch.Tensor, logits_t: torch.Tensor, alike: Similarities
) -> torch.Tensor:
    """Binary cross-entropy of (N,) logits of both scans: was the place found, both ways?"""
    truth = torch.arange(len(alike.across))
    found = (alike.across.argmax(dim=1) == truth) & (alike.across.argmax(dim=0) == truth)
    logits = torch.cat([logits_s, logits_t])
    return binary_cross_entropy_with_logits(logits, found.repeat(2).to(logits.dtype))
