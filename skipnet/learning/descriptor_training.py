"""Train the descriptor: patches of one place shall be nearer than any of different places.

Training can be interrupted: what it needs to go on is in one checkpoint, and a run that was stopped
and resumed ends with the same weights, to the bit, as one that was not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from skipnet.clouds.atomic import replacing
from skipnet.learning.descriptor_network import (
    DescriptorNetwork,
    Similarities,
    Widths,
    contrastive_loss,
    hardest_loss,
    matchability_loss,
)
from skipnet.learning.descriptor_pairs import PatchPairs, digest

FAR_VOXELS = 4.0
"""Places nearer than this to each other are neither the same nor different."""
LOSSES: dict[str, Callable[[Similarities], torch.Tensor]] = {
    "contrastive": contrastive_loss,
    "hardest": hardest_loss,
}


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
    loss: str = "contrastive"
    """One of ``LOSSES``."""
    validate_every: int = 250
    """Steps from one validation, and checkpoint, to the next."""
    patience: int = 0
    """Validations without a better score after which training ends; 0 never ends it early."""


@dataclass(frozen=True)
class Watch:
    """What is told of the training, and what it is told."""

    score: Callable[[int, DescriptorNetwork], float]
    """Called at every validation with the steps done; the higher what returns, the better."""
    on_step: Callable[[int, float], None]
    """Called after every step with its number from 1 and its loss."""


@dataclass(frozen=True)
class Outcome:
    """What training reached; the network holds the weights of the best validation."""

    network: DescriptorNetwork
    stop_reason: str
    best_step: int
    best_score: float


def train_network(
    training: Sequence[PatchPairs],
    widths: Widths,
    schedule: Schedule,
    seed: int,
    watch: Watch,
    checkpoint: Path | None = None,
) -> Outcome:
    """Fit a network to pairs of patches; the same arguments give the same weights.

    Args:
        training: per pair of scans the pairs of patches; at least as many as one step takes.
        widths: of the network.
        schedule: of the steps.
        seed: of the network's start and of what each step draws.
        watch: validates and logs.
        checkpoint: file to go on from where it exists, and to write at every validation; None
            keeps nothing.

    Raises:
        ValueError: too few pairs of scans, or the checkpoint of another training.
    """
    if len(training) < schedule.scans_per_step:
        raise ValueError(
            f"a step takes {schedule.scans_per_step} pairs of scans, but only {len(training)} are "
            "there; simulate more"
        )
    torch.set_num_threads(1)  # the order in which threads add up would show in the last bits
    run = _Run(training, widths, schedule, seed)
    if checkpoint is not None and checkpoint.exists():
        run.load(checkpoint)
    while run.stop_reason is None:
        loss = run.advance()
        watch.on_step(run.step, loss)
        if run.step % schedule.validate_every == 0 or run.step == schedule.steps:
            run.judge(watch.score(run.step, run.network.eval()))
            run.network.train()
            if checkpoint is not None:
                run.save(checkpoint)
    run.network.load_state_dict(run.best_weights)
    return Outcome(run.network.eval(), run.stop_reason, run.best_step, run.best_score)


class _Run:
    """All that changes while a network learns."""

    def __init__(
        self, training: Sequence[PatchPairs], widths: Widths, schedule: Schedule, seed: int
    ) -> None:
        self.training, self.schedule = training, schedule
        self.identity = f"{widths} {schedule} seed {seed} data {digest(training)}"
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.network = DescriptorNetwork(widths)
        some = [torch.from_numpy(pairs.source[:100]).float() for pairs in training]
        self.network.fit_scaling(torch.cat(some))
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), schedule.learning_rate, weight_decay=1e-4
        )
        self.step = self.best_step = self.fails = 0
        self.best_score = -math.inf
        self.best_weights: dict[str, torch.Tensor] = {}

    @property
    def stop_reason(self) -> str | None:
        """Why training ends here; None while it goes on."""
        if self.step >= self.schedule.steps:
            return f"all {self.schedule.steps} steps done"
        if self.schedule.patience and self.fails >= self.schedule.patience:
            return f"no better score in {self.fails} validations"
        return None

    def advance(self) -> float:
        """Do one step; its loss."""
        rate = self.schedule.learning_rate * _rate(self.step / self.schedule.steps)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        source, target, far = draw_batch(self.training, self.schedule, self.rng)
        described, logits = self.network(torch.cat([source, target]))
        described_s, described_t = described.chunk(2)
        logits_s, logits_t = logits.chunk(2)
        alike = Similarities.of(described_s, described_t, far, self.schedule.temperature)
        loss = LOSSES[self.schedule.loss](alike)
        self.optimizer.zero_grad()
        (loss + matchability_loss(logits_s, logits_t, alike)).backward()
        self.optimizer.step()
        self.step += 1
        return loss.item()

    def judge(self, score: float) -> None:
        """Keep the weights when they are the best so far."""
        if score > self.best_score:
            self.best_score, self.best_step, self.fails = score, self.step, 0
            state = self.network.state_dict()
            self.best_weights = {name: value.clone() for name, value in state.items()}
        else:
            self.fails += 1

    def save(self, path: Path) -> None:
        """Write all of it, whole or not at all."""
        with replacing(path) as temporary:
            torch.save(self._state(), temporary)

    def load(self, path: Path) -> None:
        """Go on from what ``save`` wrote.

        Raises:
            ValueError: it was written by another training.
        """
        state = torch.load(path, weights_only=True)
        if state["identity"] != self.identity:
            raise ValueError(
                f"{path} belongs to a training with other options or data; "
                "give another output_dir, or remove it to start anew"
            )
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.bit_generator.state = state["rng"]
        self.step, self.best_step, self.fails = state["step"], state["best_step"], state["fails"]
        self.best_score, self.best_weights = state["best_score"], state["best_weights"]

    def _state(self) -> dict[str, Any]:
        return {
            "identity": self.identity,
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "rng": self.rng.bit_generator.state,
            "step": self.step,
            "best_step": self.best_step,
            "fails": self.fails,
            "best_score": self.best_score,
            "best_weights": self.best_weights,
        }


def draw_batch(
    training: Sequence[PatchPairs], schedule: Schedule, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(N, 5, 50) patches of the source and of the target, and (N, N) which places are different."""
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
