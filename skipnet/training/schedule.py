"""How long a training takes, how its learning rate changes, and MATLAB's rules of when it ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Record:
    """How a training stood after one of its rounds; round 0 is before it."""

    round: int
    step: int
    """Steps done."""
    training_loss: float
    score: float
    """On the validation set; the higher, the better."""
    gradient_norm: float
    """Of the whole training set; infinite where no step sees all of it."""


@dataclass(frozen=True)
class Schedule:
    """Rounds of steps, after each of which the network is judged and may stop."""

    steps: int
    """Steps of the optimiser at most."""
    round_steps: int
    """Steps of a round; the last one may be shorter."""
    length: str
    """All of it in words, such as "25 epochs"."""
    rate: str = "constant"
    """How the learning rate changes, one of ``RATES``."""
    goal: float = 0.0
    """Training loss at which to stop."""
    min_gradient: float = 0.0
    """Length of the gradient below which to stop; 0 never stops."""
    max_fail: int = 0
    """Rounds with a lower score than the best one since that best one; 0 never stops."""

    def steps_from(self, step: int) -> int:
        """Steps of the round that begins when ``step`` are done."""
        return min(self.round_steps, self.steps - step)

    def share(self, step: int) -> float:
        """Share of the learning rate that the step takes that comes after ``step`` others."""
        return RATES[self.rate](self, step)

    def reason(self, record: Record, fails: int) -> str | None:
        """Why training ends after this round; None while it goes on."""
        if not math.isfinite(record.training_loss):
            return "the training loss is no longer finite"
        if record.training_loss <= self.goal:
            return f"goal {self.goal:g} reached"
        if record.gradient_norm < self.min_gradient:
            return f"gradient below {self.min_gradient:g}"
        if self.max_fail and fails >= self.max_fail:
            return f"{fails} validations below the best one"
        if record.step >= self.steps:
            return f"all {self.length} done"
        return None


def _cosine(schedule: Schedule, step: int) -> float:
    """Half a cosine to 0, one value per round."""
    rounds = math.ceil(schedule.steps / schedule.round_steps)
    return 0.5 * (1 + math.cos(math.pi * (step // schedule.round_steps / rounds)))


def _warm_cosine(schedule: Schedule, step: int) -> float:
    """Rises over the first tenth of the steps, then falls to 0 along half a cosine."""
    progress = step / schedule.steps
    if progress < 0.1:
        return 0.05 + 0.95 * progress / 0.1
    return 0.5 * (1 + math.cos(math.pi * (progress - 0.1) / 0.9))


RATES: dict[str, Callable[[Schedule, int], float]] = {
    "constant": lambda schedule, step: 1.0,
    "cosine": _cosine,
    "warm_cosine": _warm_cosine,
}
"""Shares of the learning rate by name."""
