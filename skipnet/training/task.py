"""What a trainer asks of a task: batches, their loss, and a score on what was not learned."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import torch
from torch import nn

from skipnet.types import IntArray

AnyNetwork = TypeVar("AnyNetwork", bound=nn.Module, contravariant=True)


@dataclass(frozen=True)
class Judgement:
    """How well a network does on the validation set."""

    score: float
    """The higher, the better; the weights of the highest one are kept."""
    figures: dict[str, float] = field(default_factory=dict)
    """By their names in TensorBoard."""
    confusion: IntArray | None = None
    """(5, 5) counts[true, predicted], of a network for the classes."""


class Task(Protocol[AnyNetwork]):
    """What a network learns."""

    @property
    def identity(self) -> str:
        """What tells it from any other: options, seed and hash of the samples."""

    @property
    def takes_all(self) -> bool:
        """Whether every step sees all samples, so that the loss is one and the same function."""

    def prepare(self, network: AnyNetwork, device: torch.device) -> None:
        """Take the scaling of the network's inputs from the samples, and bring these to it."""

    def first_loss(self, network: AnyNetwork) -> float | None:
        """The loss of all samples, which makes a round 0; None where that is not asked for."""

    def draw(self, step: int) -> tuple[Any, int]:
        """The batch of the step that comes after ``step`` others, and how much its loss counts."""

    def loss(self, network: AnyNetwork, batch: Any) -> torch.Tensor:
        """Mean loss of a batch, to be minimised."""

    def judge(self, network: AnyNetwork) -> Judgement:
        """Score a network on the validation set; called without gradients, dropout off."""

    def state(self) -> dict[str, Any]:
        """What the next draws depend on beside the step, in plain values and tensors."""

    def load(self, state: dict[str, Any]) -> None:
        """Go on from there."""
