"""Losses of the descriptor and of the matchability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from skipnet.training.networks.cyclic import MASKED


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
        itself = torch.eye(len(source), dtype=torch.bool, device=source.device)
        return Similarities(
            (source @ target.T / temperature).masked_fill_(~(far | itself), MASKED),
            (source @ source.T / temperature).masked_fill_(~far, MASKED),
            (target @ target.T / temperature).masked_fill_(~far, MASKED),
        )


def contrastive_loss(alike: Similarities) -> torch.Tensor:
    """InfoNCE (van den Oord et al., arXiv 1807.03748) both ways, with negatives from both scans.

    Returns:
        Mean over both directions of -log of the share that the true partner has; 0 is perfect.
    """
    truth = torch.arange(len(alike.across), device=alike.across.device)
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
    truth = torch.arange(len(alike.across), device=alike.across.device)
    found = (alike.across.argmax(dim=1) == truth) & (alike.across.argmax(dim=0) == truth)
    logits = torch.cat([logits_s, logits_t])
    return binary_cross_entropy_with_logits(logits, found.repeat(2).to(logits.dtype))
