"""Train a classifier until one of MATLAB's stopping rules holds, and say which one it was."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import torch

from skipnet.training.checkpoints import load_checkpoint, save_checkpoint
from skipnet.training.devices import CPU
from skipnet.training.networks.perceptron import PatchNetwork
from skipnet.training.optimizers import OptimizerFactory, ScaledConjugateGradient
from skipnet.training.stopping import EpochRecord, StoppingRules, Watch
from skipnet.training.task import Batch, TrainingSet, matlab_cross_entropy


@dataclass(frozen=True)
class TrainingOutcome:
    """What training reached. The network itself holds the weights of ``best_epoch``."""

    stop_reason: str
    best_epoch: int
    history: list[EpochRecord]

    @property
    def best(self) -> EpochRecord:
        """The record of the epoch whose weights were kept."""
        return self.history[self.best_epoch]


def train_network(
    network: PatchNetwork,
    training: TrainingSet,
    validation: TrainingSet,
    make_optimizer: OptimizerFactory,
    rules: StoppingRules,
    *,
    batch_size: int | None = None,
    cosine_decay: bool = False,
    scaling: str = "minmax",
    seed: int = 0,
    on_epoch: Callable[[EpochRecord, PatchNetwork], None] | None = None,
    checkpoint: Path | None = None,
    device: torch.device = CPU,
) -> TrainingOutcome:
    """Fit ``network`` in place; it ends on the CPU, with the weights of the lowest validation loss.

    Args:
        network: its input scaling is taken from the training patches; its dtype is the precision.
        training: the samples to fit.
        validation: the samples that decide when to stop.
        make_optimizer: called with the network's parameters.
        rules: when to stop.
        batch_size: samples per step; None takes the whole set at once, as MATLAB does.
        cosine_decay: let the learning rate fall to 0 along half a cosine over all epochs.
        scaling: of the inputs, see ``PatchNetwork.fit_scaling``.
        seed: of the order of the mini-batches.
        on_epoch: called after every epoch with its record and the network as it then is.
        checkpoint: file to go on from, if it exists, and to write after every epoch; None for none.
        device: where to compute.

    Raises:
        ValueError: mini-batches with scaled conjugate gradient, which needs one fixed function, or
            the checkpoint of another training.
    """
    dtype = network.input_gain.dtype
    train_set, validation_set = training.tensors(dtype), validation.tensors(dtype)
    network.fit_scaling(train_set[0], scaling)
    network.to(device)
    train_set, validation_set = (_moved(part, device) for part in (train_set, validation_set))
    optimizer = make_optimizer(network.parameters())
    if batch_size is not None and isinstance(optimizer, ScaledConjugateGradient):
        raise ValueError("scaled conjugate gradient needs the full batch; set batch_size=null")
    schedule = _cosine_schedule(optimizer, rules.epochs if cosine_decay else None)
    order = torch.Generator().manual_seed(seed)
    run = _Run(network, optimizer, schedule, order, Watch(rules))
    options = f"{network} {optimizer} {rules} {batch_size} {scaling} seed {seed}"
    identity = f"{options} data {training.digest()} {validation.digest()}"
    if checkpoint is not None and checkpoint.exists():
        run.load(load_checkpoint(checkpoint, identity, device))
    else:
        run.start(train_set, validation_set)
    while run.watch.stop_reason is None:
        record = run.advance(train_set, validation_set, batch_size)
        if on_epoch is not None:
            on_epoch(record, network)
        if checkpoint is not None:
            save_checkpoint(checkpoint, identity, run.state())
    network.load_state_dict(run.watch.best_state)
    network.cpu()
    return TrainingOutcome(run.watch.stop_reason, run.watch.best_epoch, run.watch.history)


@dataclass
class _Run:
    """All that changes while a network learns."""

    network: PatchNetwork
    optimizer: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LambdaLR
    order: torch.Generator
    watch: Watch

    def start(self, training: Batch, validation: Batch) -> None:
        """Record how the network does before it has learned anything."""
        network = self.network.eval()
        self.watch.see(network, _loss(network, training), _loss(network, validation), math.inf)

    def advance(self, training: Batch, validation: Batch, batch_size: int | None) -> EpochRecord:
        """One pass over the training set."""
        network, optimizer = self.network, self.optimizer
        loss = 0.0
        network.train()
        for batch in _batches(training, batch_size, self.order):
            share = len(batch[1]) / len(training[1])
            loss += share * _step(network, optimizer, batch)
        network.eval()
        self.schedule.step()
        gradient = _gradient_norm(network, optimizer) if batch_size is None else math.inf
        return self.watch.see(network, loss, _loss(network, validation), gradient)

    def state(self) -> dict[str, Any]:
        """What ``load`` takes, in plain values and tensors."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "schedule": self.schedule.state_dict(),
            "order": self.order.get_state(),
            "history": [astuple(record) for record in self.watch.history],
            "watch": {name: getattr(self.watch, name) for name in Watch.KEPT},
        }

    def load(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.schedule.load_state_dict(state["schedule"])
        self.order.set_state(state["order"].cpu())
        self.watch.history = [EpochRecord(*record) for record in state["history"]]
        for name, value in state["watch"].items():
            setattr(self.watch, name, value)


def _moved(batch: Batch, device: torch.device) -> Batch:
    patches, labels, weights = (values.to(device) for values in batch)
    return patches, labels, weights


def _batches(samples: Batch, size: int | None, generator: torch.Generator) -> Iterator[Batch]:
    if size is None:
        yield samples
        return
    shuffled = torch.randperm(len(samples[1]), generator=generator).to(samples[1].device)
    for chosen in shuffled.split(size):
        yield samples[0][chosen], samples[1][chosen], samples[2][chosen]


def _step(network: PatchNetwork, optimizer: torch.optim.Optimizer, batch: Batch) -> float:
    def closure() -> torch.Tensor:
        """The batch's loss and its gradient."""
        optimizer.zero_grad()
        loss = matlab_cross_entropy(network(batch[0]), batch[1], batch[2])
        loss.backward()
        return loss

    return torch.as_tensor(optimizer.step(closure)).item()  # type: ignore[arg-type]


@torch.no_grad()
def _loss(network: PatchNetwork, samples: Batch) -> float:
    return float(matlab_cross_entropy(network(samples[0]), samples[1], samples[2]))


def _gradient_norm(network: PatchNetwork, optimizer: torch.optim.Optimizer) -> float:
    if isinstance(optimizer, ScaledConjugateGradient):
        return optimizer.gradient_norm()
    gradients = [p.grad.norm() for p in network.parameters() if p.grad is not None]
    return float(torch.stack(gradients).norm())


def _cosine_schedule(
    optimizer: torch.optim.Optimizer, epochs: int | None
) -> torch.optim.lr_scheduler.LambdaLR:
    """A schedule to 0 over ``epochs``; None keeps the learning rate."""

    def factor(epoch: int) -> float:
        """Share of the learning rate that is left."""
        return 1.0 if epochs is None else 0.5 * (1 + math.cos(math.pi * min(epoch / epochs, 1.0)))

    for group in optimizer.param_groups:  # SCG has no learning rate; a schedule wants the name
        group.setdefault("lr", 1.0)
    return torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
