"""Train the descriptor: patches of one place shall be nearer than others, and classes told apart.

Each step shows the network pairs of patches of the same places, and labelled patches of other
scenes; what the two have in common is learned from both, and here only the descriptor is finished
(``class_head``).

Training can be interrupted: what it needs to go on is in one checkpoint, and a run that was stopped
and resumed ends with the same weights, to the bit, as one that was not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch.nn.functional import cross_entropy

from skipnet.parallel.pools import keep_freed_memory
from skipnet.training.checkpoints import load_checkpoint, save_checkpoint
from skipnet.training.data.labelled import Samples
from skipnet.training.data.pairs import PatchPairs, digest
from skipnet.training.devices import CPU, fixed_threads
from skipnet.training.networks.cyclic import DescriptorNetwork
from skipnet.training.networks.losses import (
    Similarities,
    contrastive_loss,
    hardest_loss,
    matchability_loss,
)
from skipnet.training.optimizers import ScaledConjugateGradient
from skipnet.types import FloatArray

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
    temperature: float
    """Cosine similarity that changes the odds e-fold."""
    labelled: int = 1024
    """Labelled patches of one step."""
    class_weight: float = 1.0
    """Of the classes' cross-entropy beside the descriptor's loss."""
    loss: str = "contrastive"
    """One of ``LOSSES``."""
    validate_every: int = 250
    """Steps from one validation, and checkpoint, to the next."""
    patience: int = 0
    """Validations without a better score after which training ends; 0 never ends it early."""


@dataclass(frozen=True)
class Lessons:
    """What the network learns from."""

    pairs: Sequence[PatchPairs]
    """Per pair of scans the pairs of patches; at least as many as one step takes."""
    labelled: Samples
    """Patches with their classes, and with their surroundings."""
    weights: FloatArray
    """(N,) how much each labelled one counts; only ratios matter."""

    def digest(self) -> str:
        """Hash of all of it."""
        return f"{digest(self.pairs)} {self.labelled.digest()}"


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
    lessons: Lessons,
    network: DescriptorNetwork,
    make_optimizer: Callable[..., torch.optim.Optimizer],
    schedule: Schedule,
    seed: int,
    watch: Watch,
    checkpoint: Path | None = None,
    device: torch.device = CPU,
) -> Outcome:
    """Fit a network; on the CPU the same arguments give the same weights.

    Args:
        lessons: what to learn from.
        network: as it starts; the scaling of its inputs is taken from the lessons.
        make_optimizer: called with the network's parameters. Its learning rate is the highest one:
            it rises over the first tenth of the steps and falls to 0 along half a cosine.
        schedule: of the steps.
        seed: of what each step draws.
        watch: validates and logs.
        checkpoint: file to go on from where it exists, and to write at every validation; None
            keeps nothing.
        device: where to compute.

    Raises:
        ValueError: too few pairs of scans, an optimiser for whole sets, or the checkpoint of
            another training.
    """
    if len(lessons.pairs) < schedule.scans_per_step:
        raise ValueError(
            f"a step takes {schedule.scans_per_step} pairs of scans, but only "
            f"{len(lessons.pairs)} are there; simulate more"
        )
    keep_freed_memory()
    run = _Run(lessons, network, make_optimizer, schedule, seed, device)
    if checkpoint is not None and checkpoint.exists():
        run.load(checkpoint)
    with fixed_threads():
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
        self,
        lessons: Lessons,
        network: DescriptorNetwork,
        make_optimizer: Callable[..., torch.optim.Optimizer],
        schedule: Schedule,
        seed: int,
        device: torch.device,
    ) -> None:
        self.lessons, self.schedule, self.device = lessons, schedule, device
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        some = [torch.from_numpy(pairs.source[:100]).float() for pairs in lessons.pairs]
        network.fit_scaling(torch.cat(some), torch.from_numpy(lessons.labelled.patches))
        self.network = network.to(device).train()
        self.optimizer = make_optimizer(network.parameters())
        if isinstance(self.optimizer, ScaledConjugateGradient):
            raise ValueError("scaled conjugate gradient needs all samples at once; choose another")
        self.rates = [group["lr"] for group in self.optimizer.param_groups]
        self.weights = lessons.weights / lessons.weights.mean()
        self.identity = f"{network} {self.optimizer} {schedule} seed {seed} data {lessons.digest()}"
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
        share = _rate(self.step / self.schedule.steps)
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = rate * share
        pairs = self._to_device(*draw_batch(self.lessons.pairs, self.schedule, self.rng))
        labelled = self._to_device(*self._draw_labelled())

        def closure() -> torch.Tensor:
            """The loss of this step's batch and its gradient."""
            self.optimizer.zero_grad()
            loss = self._loss(pairs, labelled)
            loss.backward()
            return loss

        loss = torch.as_tensor(self.optimizer.step(closure))  # type: ignore[arg-type]
        self.step += 1
        return loss.item()

    def _loss(
        self, pairs: Sequence[torch.Tensor], labelled: Sequence[torch.Tensor]
    ) -> torch.Tensor:
        """Of ``draw_batch``'s pairs and ``_draw_labelled``'s patches."""
        source, target, far = pairs
        details, surroundings, labels, weights = labelled
        hidden = self.network(torch.cat([source, target, surroundings]))
        described, logits = self.network.describe(hidden[: 2 * len(source)])
        described_s, described_t = described.chunk(2)
        logits_s, logits_t = logits.chunk(2)
        alike = Similarities.of(described_s, described_t, far, self.schedule.temperature)
        loss = LOSSES[self.schedule.loss](alike) + matchability_loss(logits_s, logits_t, alike)
        classes = self.network.classify(details, hidden[2 * len(source) :])
        wrong = (cross_entropy(classes, labels, reduction="none") * weights).mean()
        return loss + self.schedule.class_weight * wrong

    def _draw_labelled(self) -> list[torch.Tensor]:
        """(L, 125) details, (L, 5, 100) surroundings, (L,) classes and (L,) weights."""
        rows = self.rng.integers(len(self.lessons.labelled), size=self.schedule.labelled)
        some = self.lessons.labelled
        arrays = (some.patches, some.surroundings, some.labels, self.weights)
        details, surroundings, labels, weights = (torch.from_numpy(a[rows]) for a in arrays)
        return [details, surroundings.float(), labels, weights.float()]

    def _to_device(self, *tensors: torch.Tensor) -> list[torch.Tensor]:
        return [tensor.to(self.device) for tensor in tensors]

    def judge(self, score: float) -> None:
        """Keep the weights when they are the best so far."""
        if score > self.best_score:
            self.best_score, self.best_step, self.fails = score, self.step, 0
            state = self.network.state_dict()
            self.best_weights = {name: value.clone() for name, value in state.items()}
        else:
            self.fails += 1

    def save(self, path: Path) -> None:
        """Write all of it."""
        state = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "rng": self.rng.bit_generator.state,
            "step": self.step,
            "best_step": self.best_step,
            "fails": self.fails,
            "best_score": self.best_score,
            "best_weights": self.best_weights,
        }
        save_checkpoint(path, self.identity, state)

    def load(self, path: Path) -> None:
        """Go on from what ``save`` wrote.

        Raises:
            ValueError: it was written by another training.
        """
        state = load_checkpoint(path, self.identity, self.device)
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.bit_generator.state = state["rng"]
        self.step, self.best_step, self.fails = state["step"], state["best_step"], state["fails"]
        self.best_score, self.best_weights = state["best_score"], state["best_weights"]


def draw_batch(
    training: Sequence[PatchPairs], schedule: Schedule, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(N, 5, 100) patches of source and target, and (N, N) which places are different."""
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
