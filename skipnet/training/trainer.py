"""One training loop for every task and network: rounds of steps, judged, written, resumable.

Training can be interrupted: what it needs to go on is in one checkpoint, and a run that was stopped
and resumed ends with the same weights, to the bit, as one that was not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from skipnet.networks.devices import CPU, THREADS, fixed_threads
from skipnet.parallel.pools import keep_freed_memory
from skipnet.progress import tell
from skipnet.training.checkpoints import load_checkpoint, save_checkpoint
from skipnet.training.optimizers import OptimizerFactory, ScaledConjugateGradient
from skipnet.training.schedule import Record, Schedule
from skipnet.training.task import Judgement, Task

Network = TypeVar("Network", bound=nn.Module)

_KEPT = ("step", "best_round", "best_score", "best_state", "fails", "stop_reason")
"""What a checkpoint holds of the progress beside the history."""


@dataclass(frozen=True)
class Outcome(Generic[Network]):
    """What training reached."""

    network: Network
    """With the weights of the best round, on the CPU, dropout off."""
    stop_reason: str
    history: list[Record]
    best: Record
    """Of the round whose weights were kept."""


class Trainer(Generic[Network]):
    """Fits a network to a task.

    Args:
        task: what to learn.
        network: as it starts; trained in place.
        make_optimizer: called with the network's parameters. Its learning rate is the highest one.
        schedule: of the steps.
        checkpoint: file to go on from where it exists, and to write after every round; None keeps
            nothing.
        device: where to compute; on the CPU the same arguments give the same weights.
        on_step: called after every step with its number from 1 and its loss.
        on_round: called after every round.
        threads: of torch.

    Raises:
        ValueError: an optimiser that needs all samples in every step, and a task of mini-batches.
    """

    def __init__(
        self,
        task: Task[Network],
        network: Network,
        make_optimizer: OptimizerFactory,
        schedule: Schedule,
        checkpoint: Path | None = None,
        device: torch.device = CPU,
        on_step: Callable[[int, float], None] = lambda step, loss: None,
        on_round: Callable[[Record, Judgement], None] = lambda record, judgement: None,
        threads: int = THREADS,
    ) -> None:
        self.task, self.network, self.schedule = task, network, schedule
        self.checkpoint, self.device, self.threads = checkpoint, device, threads
        self.on_step, self.on_round = on_step, on_round
        task.prepare(network, device)
        network.to(device)
        self.optimizer = make_optimizer(network.parameters())
        if isinstance(self.optimizer, ScaledConjugateGradient) and not task.takes_all:
            raise ValueError(
                "scaled conjugate gradient needs all samples at once; choose another optimizer, "
                "or batch_size=null with network=classes"
            )
        self._rates = [group.get("lr") for group in self.optimizer.param_groups]
        self._identity = f"{network} {self.optimizer} {schedule} {task.identity}"
        self._history: list[Record] = []
        self.step = self.best_round = self.fails = 0
        self.best_score = -math.inf
        self.best_state: dict[str, torch.Tensor] = {}
        self.stop_reason: str | None = None

    def run(self) -> Outcome[Network]:
        """Learn until the schedule has a reason to stop.

        Raises:
            ValueError: the checkpoint of another training.
        """
        keep_freed_memory()
        with fixed_threads(self.threads):
            if self.checkpoint is not None and self.checkpoint.exists():
                self._resume(self.checkpoint)
            else:
                self._begin()
            while self.stop_reason is None:
                self._round()
        self.network.load_state_dict(self.best_state)
        best = next(record for record in self._history if record.round == self.best_round)
        return Outcome(self.network.cpu().eval(), self.stop_reason, self._history, best)

    def _begin(self) -> None:
        """Note how the network does before it has learned anything, where the task asks for it."""
        self.network.eval()
        with torch.no_grad():
            loss = self.task.first_loss(self.network)
            if loss is not None:
                self._note(loss, math.inf, self.task.judge(self.network))

    def _round(self) -> None:
        """Learn for a round, judge the network and write the checkpoint."""
        self.network.train()
        summed, counted = 0.0, 0
        for _ in range(self.schedule.steps_from(self.step)):
            batch, count = self.task.draw(self.step)
            loss = self._step(batch)
            summed, counted, self.step = summed + count * loss, counted + count, self.step + 1
            self.on_step(self.step, loss)
            tell("step", self.step, self.schedule.steps)
        self.network.eval()
        with torch.no_grad():
            judgement = self.task.judge(self.network)
        self.on_round(self._note(summed / counted, self._gradient_norm(), judgement), judgement)
        if self.checkpoint is not None:
            save_checkpoint(self.checkpoint, self._identity, self._state())

    def _step(self, batch: Any) -> float:
        """Do one step; its loss."""
        share = self.schedule.share(self.step)
        for group, rate in zip(self.optimizer.param_groups, self._rates, strict=True):
            if rate is not None:
                group["lr"] = rate * share

        def closure() -> torch.Tensor:
            """The loss of the batch and its gradient."""
            self.optimizer.zero_grad()
            loss = self.task.loss(self.network, batch)
            loss.backward()
            return loss

        return torch.as_tensor(self.optimizer.step(closure)).item()  # type: ignore[arg-type]

    def _note(self, loss: float, gradient: float, judgement: Judgement) -> Record:
        """Keep the record of a round, and the weights when they are the best so far."""
        rounds = self._history[-1].round + 1 if self._history else int(self.step > 0)
        record = Record(rounds, self.step, loss, judgement.score, gradient)
        self._history.append(record)
        if record.score > self.best_score or not self.best_state:
            self.best_round, self.best_score, self.fails = record.round, record.score, 0
            self.best_state = {n: value.clone() for n, value in self.network.state_dict().items()}
        elif record.score < self.best_score:
            self.fails += 1
        self.stop_reason = self.schedule.reason(record, self.fails)
        return record

    def _gradient_norm(self) -> float:
        """Length of the gradient over all samples, where the last step has seen them all."""
        if not self.task.takes_all:
            return math.inf
        if isinstance(self.optimizer, ScaledConjugateGradient):
            return self.optimizer.gradient_norm()
        gradients = [p.grad.norm() for p in self.network.parameters() if p.grad is not None]
        return float(torch.stack(gradients).norm())

    def _state(self) -> dict[str, Any]:
        """What ``_load`` takes, in plain values and tensors."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "task": self.task.state(),
            "history": [astuple(record) for record in self._history],
            "progress": {name: getattr(self, name) for name in _KEPT},
        }

    def _resume(self, checkpoint: Path) -> None:
        """Go on from a checkpoint, which has to fit."""
        state = load_checkpoint(checkpoint, self._identity, self.device)
        try:
            self._load(state)
        except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
            message = " ".join(str(error).split())[:160]
            raise ValueError(
                f"{checkpoint}: damaged: remove it to start anew ({message})"
            ) from error

    def _load(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.task.load(state["task"])
        self._history = [Record(*values) for values in state["history"]]
        for name in _KEPT:
            setattr(self, name, state["progress"][name])
