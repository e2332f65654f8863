"""Train the descriptor: patches of one place shall be nearer than any of different places."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import cross_entropy, normalize

from skipnet.features.cylinders import SECTOR_SIZE, SECTORS
from skipnet.learning.descriptor import LAYERS
from skipnet.learning.descriptor_pairs import PatchPairs
from skipnet.types import FloatArray

FAR_VOXELS = 4.0
"""Places nearer than this to each other are neither the same nor different."""
_MASKED = -1e4


@dataclass(frozen=True)
class Widths:
    """Units of the network's layers."""

    hidden: int = 128
    output: int = 32


@dataclass(frozen=True)
class Schedule:
    """How long and in which steps the network learns."""

    steps: int
    scans_per_step: int
    """Pairs of scans whose patches meet in one step ..."""
    pairs_per_scans: int
    """... and pairs of patches from each of them."""
    learning_rate: float
    """Its maximum; it rises over the first tenth and falls to 0 along half a cosine."""
    temperature: float
    """Cosine similarity that changes the odds e-fold."""


class DescriptorNetwork(nn.Module):
    """The network of ``skipnet.learning.descriptor.Descriptor`` in torch.

    Args:
        widths: units of its layers.
    """

    input_mean: torch.Tensor
    input_gain: torch.Tensor

    def __init__(self, widths: Widths) -> None:
        super().__init__()
        self.first = nn.Linear(SECTORS * SECTOR_SIZE, widths.hidden)
        self.second = nn.Linear(widths.hidden, widths.hidden)
        self.output = nn.Linear(widths.hidden, widths.output)
        self.register_buffer("input_mean", torch.zeros(SECTOR_SIZE))
        self.register_buffer("input_gain", torch.ones(SECTOR_SIZE))

    def fit_scaling(self, patches: torch.Tensor) -> None:
        """Bring each input to mean 0 and deviation 1 over (N, 5, 75) patches and all sectors."""
        self.input_mean.copy_(patches.mean(dim=(0, 1)))
        self.input_gain.copy_(1 / (patches.std(dim=(0, 1)) + 1e-2))

    def forward(self, patches: torch.Tensor) -> torch.Tensor:
        """(N, 5, 75) patches to (N, D) descriptors of length 1."""
        scaled = (patches - self.input_mean) * self.input_gain
        responses = [
            torch.relu(self.second(torch.relu(self.first(scaled.roll(turn, 1).flatten(1)))))
            for turn in range(SECTORS)
        ]
        return normalize(self.output(torch.stack(responses).amax(dim=0)), dim=1)

    def arrays(self) -> dict[str, FloatArray]:
        """The weights as ``Descriptor`` takes them, the scaling of the inputs folded in."""
        weights: dict[str, FloatArray] = {}
        for name in LAYERS:
            layer: nn.Linear = getattr(self, name)
            weights[f"{name}_weight"] = layer.weight.detach().numpy().T.copy()
            weights[f"{name}_bias"] = layer.bias.detach().numpy().copy()
        weights["first_weight"] *= np.tile(self.input_gain.numpy(), SECTORS)[:, None]
        weights["first_bias"] -= np.tile(self.input_mean.numpy(), SECTORS) @ weights["first_weight"]
        return weights


def contrastive_loss(
    source: torch.Tensor, target: torch.Tensor, far: torch.Tensor, temperature: float
) -> torch.Tensor:
    """InfoNCE (van den Oord et al., arXiv 1807.03748) both ways, with negatives from both scans.

    Args:
        source: (N, D) descriptors of length 1 ...
        target: (N, D) ... and of the same places in the other scan.
        far: (N, N) bool, which places count as different; never a place and itself.
        temperature: cosine similarity that changes the odds e-fold.

    Returns:
        Mean over both directions of -log of the share that the true partner has; 0 is perfect.
    """
    itself = torch.eye(len(source), dtype=torch.bool)
    across = (source @ target.T / temperature).masked_fill(~(far | itself), _MASKED)
    within_s = (source @ source.T / temperature).masked_fill(~far, _MASKED)
    within_t = (target @ target.T / temperature).masked_fill(~far, _MASKED)
    truth = torch.arange(len(source))
    forward = cross_entropy(torch.cat([across, within_s], dim=1), truth)
    backward = cross_entropy(torch.cat([across.T, within_t], dim=1), truth)
    return (forward + backward) / 2


def train_network(
    training: Sequence[PatchPairs],
    widths: Widths,
    schedule: Schedule,
    seed: int,
    on_step: Callable[[int, float, DescriptorNetwork], None],
) -> DescriptorNetwork:
    """Fit a network to pairs of patches; the same arguments give the same weights.

    Args:
        training: per pair of scans the pairs of patches; at least as many as one step takes.
        widths: of the network.
        schedule: of the steps.
        seed: of the network's start and of what each step draws.
        on_step: called after every step with its number from 1, its loss and the network.

    Raises:
        ValueError: too few pairs of scans.
    """
    if len(training) < schedule.scans_per_step:
        raise ValueError(
            f"a step takes {schedule.scans_per_step} pairs of scans, but only {len(training)} are "
            "there; simulate more"
        )
    torch.set_num_threads(1)  # the order in which threads add up would show in the last bits
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = DescriptorNetwork(widths)
    network.fit_scaling(torch.cat([torch.from_numpy(p.source[:100]).float() for p in training]))
    optimizer = torch.optim.AdamW(network.parameters(), schedule.learning_rate, weight_decay=1e-4)
    rate = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _rate(step / schedule.steps))
    for step in range(1, schedule.steps + 1):
        source, target, far = draw_batch(training, schedule, rng)
        described_s, described_t = network(torch.cat([source, target])).chunk(2)
        loss = contrastive_loss(described_s, described_t, far, schedule.temperature)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
        on_step(step, loss.item(), network)
    return network.eval()


def draw_batch(
    training: Sequence[PatchPairs], schedule: Schedule, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(N, 5, 75) patches of the source and of the target, and (N, N) which places are different."""
    chosen = rng.choice(len(training), schedule.scans_per_step, replace=False)
    source, target, places, owner = [], [], [], []
    for scans in chosen:
        pairs = training[scans]
        rows = rng.permutation(len(pairs))[: schedule.pairs_per_scans]
        source.append(pairs.source[rows])
        target.append(pairs.target[rows])
        places.append(pairs.places[rows])
        owner.append(np.full(len(rows), scans))
    place = torch.from_numpy(np.concatenate(places))
    scan = torch.from_numpy(np.concatenate(owner))
    far = (torch.cdist(place, place) >= FAR_VOXELS) | (scan[:, None] != scan)
    patches = [torch.from_numpy(np.concatenate(side)).float() for side in (source, target)]
    return patches[0], patches[1], far


def _rate(progress: float) -> float:
    """Share of the learning rate's maximum at a share of the steps."""
    if progress < 0.1:
        return 0.05 + 0.95 * progress / 0.1
    return 0.5 * (1 + math.cos(math.pi * (progress - 0.1) / 0.9))
