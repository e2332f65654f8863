"""MATLAB's stopping rules, and the best weights on the way there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from skipnet.training.networks.perceptron import PatchNetwork


@dataclass(frozen=True)
class StoppingRules:
    """When training ends; the defaults are those of MATLAB's ``trainscg``."""

    epochs: int = 1000
    """Passes over the training set at most."""
    goal: float = 0.0
    """Training loss, as ``matlab_cross_entropy`` counts it, at which to stop."""
    min_gradient: float = 1e-6
    """Length of the full-batch gradient below which to stop; 0 never stops."""
    max_fail: int = 6
    """Epochs with a validation loss above the best one since that best one; 0 never stops."""


@dataclass(frozen=True)
class EpochRecord:
    """Losses (``matlab_cross_entropy``) after one epoch; epoch 0 is before training."""

    epoch: int
    training_loss: float
    validation_loss: float
    gradient_norm: float


class Watch:
    """Keeps the history and the best weights, and knows when to stop."""

    KEPT = ("best_epoch", "best_loss", "fails", "best_state", "stop_reason")
    """What a checkpoint holds of it beside the history."""

    def __init__(self, rules: StoppingRules) -> None:
        self.rules = rules
        self.history: list[EpochRecord] = []
        self.best_epoch, self.best_loss, self.fails = 0, math.inf, 0
        self.best_state: dict[str, torch.Tensor] = {}
        self.stop_reason: str | None = None

    def see(
        self, network: PatchNetwork, training_loss: float, validation_loss: float, gradient: float
    ) -> EpochRecord:
        """Take note of an epoch's losses and gradient, and of the weights if they are the best."""
        record = EpochRecord(len(self.history), training_loss, validation_loss, gradient)
        self.history.append(record)
        if validation_loss < self.best_loss:
            self.best_epoch, self.best_loss, self.fails = record.epoch, validation_loss, 0
            self.best_state = {name: value.clone() for name, value in network.state_dict().items()}
        elif validation_loss > self.best_loss:
            self.fails += 1
        self.stop_reason = self._reason(record)
        return record

    def _reason(self, record: EpochRecord) -> str | None:
        rules = self.rules
        if not math.isfinite(record.training_loss):
            return "the training loss is no longer finite"
        if record.training_loss <= rules.goal:
            return f"goal {rules.goal:g} reached"
        if record.gradient_norm < rules.min_gradient:
            return f"gradient below {rules.min_gradient:g}"
        if rules.max_fail and self.fails >= rules.max_fail:
            return f"validation loss above its best for {rules.max_fail} epochs"
        if record.epoch >= rules.epochs:
            return f"all {rules.epochs} epochs done"
        return None
