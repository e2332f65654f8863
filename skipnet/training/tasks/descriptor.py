"""The task of the descriptor: patches of one place shall be nearer than others.

Each step shows the network pairs of patches of the same places. With them may come labelled patches
of other scenes: what the two have in common is then learned from both, and only the descriptor is
finished here (``tasks.classes`` learns the class head).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import nn
from torch.nn.functional import cross_entropy

from skipnet.metrics.correspondences import ENOUGH_INLIERS, Keypoints, range_of
from skipnet.networks.model import Model
from skipnet.training.data.factory import PatchFactory
from skipnet.training.data.labelled import Samples
from skipnet.training.data.pairs import PatchPairs, digest
from skipnet.training.networks.losses import (
    Similarities,
    contrastive_loss,
    hardest_loss,
    matchability_loss,
)
from skipnet.training.task import Judgement
from skipnet.types import FloatArray

FAR_VOXELS = 4.0
"""Places nearer than this to each other are neither the same nor different."""
LOSSES: dict[str, Callable[[Similarities], torch.Tensor]] = {
    "contrastive": contrastive_loss,
    "hardest": hardest_loss,
}


@dataclass(frozen=True)
class StepPlan:
    """What one step shows, and what counts in its loss."""

    scans: int
    """Pairs of scans whose patches meet ..."""
    pairs_per_scans: int
    """... and pairs of patches from each of them."""
    temperature: float
    """Cosine similarity that changes the odds e-fold."""
    labelled: int = 1024
    """Labelled patches."""
    class_weight: float = 1.0
    """Of the classes' cross-entropy beside the descriptor's loss."""
    loss: str = "contrastive"
    """One of ``LOSSES``."""


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

    def pairs_at(self, step: int) -> Sequence[PatchPairs]:
        """What a step may learn from: always all."""
        return self.pairs

    def figures(self) -> dict[str, float]:
        """For TensorBoard: how fast they come; these are all there."""
        return {}

    def scaling(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Patches, and details of labelled ones, from which the inputs' scaling is taken."""
        some = [torch.from_numpy(pairs.source[:100]).float() for pairs in self.pairs]
        return torch.cat(some), torch.from_numpy(self.labelled.patches)


class Batch(NamedTuple):
    """What one step shows."""

    source: torch.Tensor
    """(N, ...) patches of the source ..."""
    target: torch.Tensor
    """(N, ...) ... and of the same places in the target."""
    far: torch.Tensor
    """(N, N) which places are different."""
    labelled: Sequence[torch.Tensor]
    """(L, 125) details, (L, ...) surroundings, (L,) classes and (L,) weights; or nothing."""


class PlaceNetwork(Protocol):
    """What a network must be able to do to learn this task."""

    def __call__(self, patches: torch.Tensor) -> torch.Tensor:
        """(N, ...) patches to (N, H) hidden units."""

    def recognise(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, H) hidden units to (N, D) descriptors of length 1 and (N,) matchability logits."""

    def model(self) -> Model:
        """As it is used, with the weights that it has now."""


class DescriptorTask:
    """Pairs of patches, labelled patches, and scans to judge by.

    Args:
        lessons: what to learn from.
        plan: of a step.
        unseen: keypoints of the scans to judge by.
        seed: of what each step draws, and of dropout.
    """

    takes_all = False

    def __init__(
        self,
        lessons: Lessons | PatchFactory,
        plan: StepPlan,
        unseen: Sequence[Keypoints],
        seed: int,
    ) -> None:
        self.lessons, self.plan, self.unseen, self._seed = lessons, plan, unseen, seed
        self._random = np.random.default_rng(seed)
        self.identity = f"descriptor {plan} seed {seed} data {lessons.digest()}"

    def prepare(self, network: Any, device: torch.device) -> None:
        """See ``Task``; also sets torch's random state, from which dropout draws."""
        torch.manual_seed(self._seed)
        _check_enough(self.lessons.pairs_at(0), self.plan)
        network.fit_scaling(*self.lessons.scaling())
        self._device = device

    def first_loss(self, network: nn.Module) -> None:
        """See ``Task``."""

    def draw(self, step: int) -> tuple[Batch, int]:
        """Pairs of a few scans, and labelled patches."""
        drawn = draw_pairs(self.lessons.pairs_at(step), self.plan, self._random)
        labelled = [] if self.lessons.labelled is None else self._draw_labelled(self.lessons)
        source, target, far = (values.to(self._device) for values in drawn)
        return Batch(source, target, far, [values.to(self._device) for values in labelled]), 1

    def _draw_labelled(self, lessons: Lessons) -> list[torch.Tensor]:
        """(L, 125) details, (L, 5, 100) surroundings, (L,) classes and (L,) weights."""
        some = lessons.labelled
        rows = self._random.integers(len(some), size=self.plan.labelled)
        weight = lessons.weights / lessons.weights.mean()
        arrays = (some.patches, some.surroundings, some.labels, weight)
        details, surroundings, labels, weights = (torch.from_numpy(a[rows]) for a in arrays)
        return [details, surroundings.float(), labels, weights.float()]

    def loss(self, network: Any, batch: Batch) -> torch.Tensor:
        """Of the descriptors, of what is said of their matchability, and of the classes."""
        pairs = 2 * len(batch.source)
        hidden = network(torch.cat([batch.source, batch.target, *batch.labelled[1:2]]))
        loss = recognition_loss(network, hidden[:pairs], batch.far, self.plan)
        if not batch.labelled:
            return loss
        details, _, labels, weights = batch.labelled
        classes = network.classify(details, hidden[pairs:])
        wrong = (cross_entropy(classes, labels, reduction="none") * weights).mean()
        return loss + self.plan.class_weight * wrong

    def judge(self, network: Any) -> Judgement:
        """Mean inlier ratio on the unseen scans; figures also hold the share of matched pairs."""
        judgement = judge_inliers(network.model(), self.unseen)
        return replace(judgement, figures={**judgement.figures, **self.lessons.figures()})

    def state(self) -> dict[str, Any]:
        """See ``Task``."""
        return {"rng": self._random.bit_generator.state}

    def load(self, state: dict[str, Any]) -> None:
        """See ``Task``."""
        self._random.bit_generator.state = state["rng"]


def recognition_loss(
    network: PlaceNetwork, hidden: torch.Tensor, far: torch.Tensor, plan: StepPlan
) -> torch.Tensor:
    """Of descriptors and matchability.

    Args:
        network: whose heads to use.
        hidden: (2 N, H) of N places, first all of the source, then all of the target.
        far: (N, N) which places are different.
        plan: temperature and loss.
    """
    described, logits = network.recognise(hidden)
    described_s, described_t = described.chunk(2)
    logits_s, logits_t = logits.chunk(2)
    alike = Similarities.of(described_s, described_t, far, plan.temperature)
    return LOSSES[plan.loss](alike) + matchability_loss(logits_s, logits_t, alike)


def judge_inliers(model: Model, unseen: Sequence[Keypoints]) -> Judgement:
    """Mean inlier ratio on unseen scans, and the share of them with enough right matches."""
    ratios = np.array([keypoints.inlier_ratio(model) for keypoints in unseen])
    figures = {
        "inlier_ratio/validation": float(ratios.mean()),
        "matched_pairs/validation": float((ratios >= ENOUGH_INLIERS).mean()),
    }
    ranges = np.array([range_of(keypoints.overlap) for keypoints in unseen])
    for name in np.unique(ranges):
        figures[f"inlier_ratio/overlap {name}"] = float(ratios[ranges == name].mean())
    return Judgement(float(ratios.mean()), figures)


def draw_pairs(
    training: Sequence[PatchPairs], plan: StepPlan, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(N, ...) patches of source and target, and (N, N) which places are different."""
    _check_enough(training, plan)
    chosen = rng.choice(len(training), plan.scans, replace=False)
    return join_pairs([training[scans] for scans in chosen], plan, rng)


def _check_enough(training: Sequence[PatchPairs], plan: StepPlan) -> None:
    if len(training) < plan.scans:
        raise ValueError(
            f"a step takes {plan.scans} pairs of scans, but only {len(training)} are there; "
            "simulate more"
        )


def join_pairs(
    chosen: Sequence[PatchPairs], plan: StepPlan, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """As ``draw_pairs``, of the chosen pairs of scans."""
    rows = [rng.permutation(len(pairs))[: plan.pairs_per_scans] for pairs in chosen]
    sides = [
        np.concatenate([side[some] for side, some in zip(patches, rows, strict=True)])
        for patches in ([p.source for p in chosen], [p.target for p in chosen])
    ]
    drawn = zip(chosen, rows, strict=True)
    place = torch.from_numpy(np.concatenate([pairs.places[some] for pairs, some in drawn]))
    scan = torch.repeat_interleave(torch.tensor([len(some) for some in rows]))
    far = (torch.cdist(place, place) >= FAR_VOXELS) | (scan[:, None] != scan)
    source, target = (torch.from_numpy(side).float() for side in sides)
    return source, target, far
