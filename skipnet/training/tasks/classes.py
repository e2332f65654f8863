"""The task of telling the classes apart: of a network for them alone, and of the class head.

The class head is learned last, with the layers that it shares with the descriptor held fixed. Then
the hidden units of a labelled patch are numbers like its 125 cells, read off once, and the head
learns as a network for the classes alone does.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.functional import cross_entropy

from skipnet.metrics.classes import confusion_matrix, macro_f1
from skipnet.networks.devices import find_device
from skipnet.networks.numpy_network import CLASS_LAYERS, SmallNetwork
from skipnet.training.data.labelled import Samples
from skipnet.training.networks.cyclic import layer_arrays
from skipnet.training.networks.perceptron import PATCH_SIZE, PatchNetwork
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.schedule import Record, Schedule
from skipnet.training.scores import CLASS_NAMES
from skipnet.training.task import Judgement
from skipnet.training.trainer import Outcome, Trainer
from skipnet.types import FloatArray, IntArray

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""(N, 125) patches, (N,) labels, (N,) weights of mean 1."""


@dataclass(frozen=True)
class TrainingSet:
    """What a network is fitted to, or judged on."""

    patches: FloatArray
    """(N, 125)."""
    labels: IntArray
    """(N,) classes."""
    weights: FloatArray | None = None
    """(N,) how much each sample's loss counts; only ratios matter. None counts all alike."""

    def digest(self) -> str:
        """Hash of it."""
        sha = hashlib.sha256()
        for values in (self.patches, self.labels, self.weights):
            sha.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
        return sha.hexdigest()[:16]

    def tensors(self, dtype: torch.dtype) -> Batch:
        """Patches, labels and weights of mean 1.

        Raises:
            ValueError: no samples, or not one label for each.
        """
        count = len(self.labels)
        if count == 0 or len(self.patches) != count:
            raise ValueError(
                f"need one label per patch, got {count} labels for {len(self.patches)} patches"
            )
        weights = np.ones(count) if self.weights is None else self.weights / self.weights.mean()
        return (
            torch.as_tensor(self.patches, dtype=dtype),
            torch.as_tensor(self.labels, dtype=torch.int64),
            torch.as_tensor(weights, dtype=dtype),
        )


def matlab_cross_entropy(
    logits: torch.Tensor, labels: torch.Tensor, weights: torch.Tensor | None = None
) -> torch.Tensor:
    """MATLAB's ``crossentropy``: the mean over outputs x samples, a fifth of PyTorch's for five.

    ``weights`` (N,) multiply each sample's loss; leave them out for weights of 1.
    """
    loss = cross_entropy(logits, labels, reduction="none")
    return (loss if weights is None else loss * weights).mean() / logits.shape[1]


class ClassTask:
    """Labelled samples, in mini-batches or all at once, and others to judge by.

    Args:
        training: the samples to fit.
        validation: the samples to judge by.
        batch_size: samples per step; None takes the whole set at once, as MATLAB does.
        scaling: of the inputs, see ``PatchNetwork.fit_scaling``.
        seed: of the order of the mini-batches.
    """

    def __init__(
        self,
        training: TrainingSet,
        validation: TrainingSet,
        batch_size: int | None = None,
        scaling: str = "minmax",
        seed: int = 0,
    ) -> None:
        self.takes_all, self._scaling = batch_size is None, scaling
        self._size = batch_size or max(len(training.labels), 1)
        data = f"data {training.digest()} {validation.digest()}"
        self.identity = f"classes {batch_size} {scaling} seed {seed} {data}"
        self._sets = training, validation
        self._random = torch.Generator().manual_seed(seed)

    @property
    def steps_per_pass(self) -> int:
        """Steps that take every sample once."""
        return math.ceil(len(self._sets[0].labels) / self._size)

    def prepare(self, network: PatchNetwork, device: torch.device) -> None:
        """See ``Task``."""
        dtype = network.input_gain.dtype
        training, validation = (part.tensors(dtype) for part in self._sets)
        network.fit_scaling(training[0], self._scaling)
        self._training, self._validation = (_moved(p, device) for p in (training, validation))

    def first_loss(self, network: PatchNetwork) -> float:
        """See ``Task``."""
        return float(self.loss(network, self._training))

    def draw(self, step: int) -> tuple[Batch, int]:
        """The next samples in the order of this pass."""
        if self.takes_all:
            return self._training, len(self._training[1])
        place = step % self.steps_per_pass
        if place == 0:
            count = len(self._training[1])
            order = torch.randperm(count, generator=self._random)
            self._order = order.to(self._training[1].device).split(self._size)
        patches, labels, weights = (values[self._order[place]] for values in self._training)
        return (patches, labels, weights), len(labels)

    def loss(self, network: PatchNetwork, batch: Batch) -> torch.Tensor:
        """``matlab_cross_entropy``."""
        return matlab_cross_entropy(network(batch[0]), batch[1], batch[2])

    def judge(self, network: PatchNetwork) -> Judgement:
        """The validation loss, negative; figures also hold accuracy, F1 and recalls."""
        patches, labels, weights = self._validation
        logits = network(patches)
        loss = float(matlab_cross_entropy(logits, labels, weights))
        counts = confusion_matrix(labels.cpu().numpy(), logits.argmax(dim=1).cpu().numpy())
        recalls = np.diag(counts) / np.maximum(counts.sum(axis=1), 1)
        figures = {
            "loss/validation": loss,
            "accuracy/validation": float(np.trace(counts) / counts.sum()),
            "macro_f1/validation": macro_f1(counts),
            **{f"recall/{name}": float(r) for name, r in zip(CLASS_NAMES, recalls, strict=True)},
        }
        return Judgement(-loss, figures, counts)

    def state(self) -> dict[str, Any]:
        """See ``Task``."""
        return {"order": self._random.get_state()}

    def load(self, state: dict[str, Any]) -> None:
        """See ``Task``."""
        self._random.set_state(state["order"].cpu())


def _moved(batch: Batch, device: torch.device) -> Batch:
    patches, labels, weights = (values.to(device) for values in batch)
    return patches, labels, weights


def class_schedule(config: TrainConfig, task: ClassTask) -> Schedule:
    """Epochs and MATLAB's stopping rules under this configuration."""
    return Schedule(
        steps=config.epochs * task.steps_per_pass,
        round_steps=task.steps_per_pass,
        length=f"{config.epochs} epochs",
        rate="cosine" if config.cosine_decay else "constant",
        goal=config.goal,
        min_gradient=config.min_gradient,
        max_fail=config.max_fail,
    )


def sample_weights(samples: Samples, frequency_strength: float) -> FloatArray:
    """(N,) weights of the loss: thinned classes get back this power of what thinning took."""
    return samples.weights**frequency_strength


def train_classifier(
    config: TrainConfig,
    training: Samples,
    validation: Samples,
    on_round: Callable[[Record, Judgement], None] = lambda record, judgement: None,
    checkpoint: Path | None = None,
) -> Outcome[PatchNetwork]:
    """Train a network for the classes; beside its 125 cells a sample may have further inputs."""
    torch.manual_seed(config.seed)
    network = PatchNetwork(
        config.hidden_sizes,
        config.activation.value,
        config.dropout,
        beside=training.patches.shape[1] - PATCH_SIZE,
        beside_dropout=config.descriptor.hidden_dropout,
    )
    if config.double_precision:
        network.double()
    fitted, judged_on = (
        TrainingSet(part.patches, part.labels, sample_weights(part, config.frequency_strength))
        for part in (training, validation)
    )
    task = ClassTask(fitted, judged_on, config.batch_size, config.input_scaling.value, config.seed)
    return Trainer(
        task,
        network,
        find_optimizer(config.optimizer),
        class_schedule(config, task),
        checkpoint,
        find_device(config.device.value),
        on_round=on_round,
    ).run()


def with_hidden(samples: Samples, shared: SmallNetwork) -> Samples:
    """The samples with what the shared layers make of their surroundings beside the 125 cells."""
    hidden = shared.hidden(samples.surroundings)
    return replace(samples, patches=np.concatenate([samples.patches, hidden], axis=1))


def head_arrays(head: PatchNetwork) -> dict[str, FloatArray]:
    """The layers of the class head as ``SmallNetwork`` takes them."""
    detail, *others = (layer for layer in head.layers if isinstance(layer, nn.Linear))
    arrays = layer_arrays(CLASS_LAYERS[0], detail, head.input_offset, head.input_gain)
    for name, layer in zip(CLASS_LAYERS[1:], others, strict=True):
        arrays |= layer_arrays(name, layer)
    return arrays
