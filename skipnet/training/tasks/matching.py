"""The task of the matcher: keypoints of one place shall take each other for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from skipnet.networks.matcher import MatcherNetwork, matches
from skipnet.networks.tokens import Tokens
from skipnet.training.data.factory import Factory
from skipnet.training.data.token_pairs import NOTHING_HIDDEN, Hiding, Lesson, TokenPair
from skipnet.training.networks.cyclic import MASKED
from skipnet.training.task import Judgement

LIKELIEST = 100
"""Of the keypoints that take each other for one place so many likeliest ones are judged."""


@dataclass(frozen=True)
class MatchingPlan:
    """What one step shows."""

    scans: int
    """Pairs of scans ..."""
    keypoints: int
    """... and keypoints of each scan."""
    hiding: Hiding = NOTHING_HIDDEN
    """What of them is hidden."""


class MatchingTask:
    """Keypoints of two scans, and scans to judge by.

    Args:
        lessons: what to learn from.
        plan: of a step.
        unseen: to judge by.
        seed: of what each step draws.
    """

    takes_all = False

    def __init__(
        self,
        lessons: Factory[TokenPair],
        plan: MatchingPlan,
        unseen: Sequence[TokenPair],
        seed: int,
    ) -> None:
        self.lessons, self.plan, self.unseen = lessons, plan, unseen
        self._random = np.random.default_rng(seed)
        self.identity = f"matching {plan} seed {seed} data {lessons.digest()}"

    def prepare(self, network: MatcherNetwork, device: torch.device) -> None:
        """See ``Task``."""
        self._device = device

    def first_loss(self, network: MatcherNetwork) -> None:
        """See ``Task``."""

    def draw(self, step: int) -> tuple[list[Lesson], int]:
        """Some keypoints of a few pairs of scans."""
        at_hand = self.lessons.pairs_at(step)
        chosen = self._random.integers(len(at_hand), size=self.plan.scans)
        shown = self.plan.keypoints, self._random, self.plan.hiding
        drawn = [at_hand[one].draw(*shown) for one in chosen]
        return [_on(lesson, self._device) for lesson in drawn], 1

    def loss(self, network: MatcherNetwork, batch: list[Lesson]) -> torch.Tensor:
        """Mean of the pairs' losses."""
        losses = []
        for one in batch:
            alike, partner_s, partner_t = network(one.source, one.target, one.oriented)
            losses.append(matching_loss(alike, partner_s, partner_t, one.same))
        return torch.stack(losses).mean()

    def judge(self, network: MatcherNetwork) -> Judgement:
        """Mean share of right ones among the likeliest on the unseen scans."""
        shares = np.array([self._share(network, pair) for pair in self.unseen])
        figures = {"inlier_ratio/validation": float(shares.mean()), **self.lessons.figures()}
        return Judgement(float(shares.mean()), figures)

    def _share(self, network: MatcherNetwork, pair: TokenPair) -> float:
        """Of right ones among the likeliest keypoints that take each other for one place."""
        lesson = _on(pair.whole(), self._device)
        likely = matches(*network(lesson.source, lesson.target, lesson.oriented))
        chosen = likely.argmax(dim=1)
        mutual = likely.argmax(dim=0)[chosen] == torch.arange(len(chosen), device=chosen.device)
        rows = torch.nonzero(mutual)[:, 0]
        best = likely[rows, chosen[rows]].argsort(descending=True)[:LIKELIEST]
        return float(lesson.same[rows[best], chosen[rows[best]]].float().mean())

    def state(self) -> dict[str, Any]:
        """See ``Task``."""
        return {"rng": self._random.bit_generator.state}

    def load(self, state: dict[str, Any]) -> None:
        """See ``Task``."""
        self._random.bit_generator.state = state["rng"]


def matching_loss(
    alike: torch.Tensor, partner_s: torch.Tensor, partner_t: torch.Tensor, same: torch.Tensor
) -> torch.Tensor:
    """Of what ``MatcherNetwork`` says of two scans.

    Args:
        alike: (K, L) logits.
        partner_s: (K,) logits of having a partner at all.
        partner_t: (L,) likewise.
        same: (K, L) which are one place.

    Returns:
        Mean over both directions of -log of the share that the true partners of a keypoint have
        together, of those that have some, and of the cross-entropy of having any.
    """
    missed = [_missed(logits, true) for logits, true in ((alike, same), (alike.T, same.T))]
    any_s, any_t = (same.any(dim=axis).float() for axis in (1, 0))
    unsure = binary_cross_entropy_with_logits(partner_s, any_s)
    unsure = unsure + binary_cross_entropy_with_logits(partner_t, any_t)
    return (torch.stack(missed).sum() + unsure) / 2


def _missed(alike: torch.Tensor, same: torch.Tensor) -> torch.Tensor:
    """Mean over the rows with a true partner of -log of these partners' share; 0 without any."""
    rows = same.any(dim=1)
    if not rows.any():
        return alike.new_zeros(())
    shares = alike.log_softmax(dim=1)[rows]
    return -shares.masked_fill(~same[rows], MASKED).logsumexp(dim=1).mean()


def _on(lesson: Lesson, device: torch.device) -> Lesson:
    """The same on a device."""
    source, target = (
        Tokens(*(values.to(device) for values in scan)) for scan in (lesson.source, lesson.target)
    )
    return Lesson(source, target, lesson.same.to(device), lesson.oriented)
