"""The class head: learned last, with the layers that it shares with the descriptor held fixed.

Then the hidden units of a labelled patch are numbers like its 125 cells, read off once, and the
head learns as a network for the classes alone does (``experiment.train_classifier``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from skipnet.networks.numpy_network import CLASS_LAYERS, SmallNetwork
from skipnet.training.data.labelled import Samples
from skipnet.training.devices import find_device, fixed_threads
from skipnet.training.networks.cyclic import layer_arrays
from skipnet.training.networks.perceptron import PATCH_SIZE, PatchNetwork
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.task import TrainingSet
from skipnet.training.trainer import EpochRecord, StoppingRules, TrainingOutcome, train_network
from skipnet.types import FloatArray


def with_hidden(samples: Samples, shared: SmallNetwork) -> Samples:
    """The samples with what the shared layers make of their surroundings beside the 125 cells."""
    hidden = shared.hidden(samples.surroundings)
    return replace(samples, patches=np.concatenate([samples.patches, hidden], axis=1))


def fit_class_head(
    config: TrainConfig,
    training: Samples,
    validation: Samples,
    on_epoch: Callable[[EpochRecord, PatchNetwork], None],
    checkpoint: Path,
) -> dict[str, FloatArray]:
    """The weights of the class head.

    Args:
        config: ``hidden_sizes`` and all that says how the classes learn.
        training: from ``with_hidden``.
        validation: from ``with_hidden``.
        on_epoch: called after every epoch.
        checkpoint: file to go on from where it exists, and to write after every epoch.
    """
    head, _ = train_classifier(config, training, validation, on_epoch, checkpoint)
    return head_arrays(head.float())


def head_arrays(head: PatchNetwork) -> dict[str, FloatArray]:
    """The layers as ``SmallNetwork`` takes them."""
    detail, *others = (layer for layer in head.layers if isinstance(layer, nn.Linear))
    arrays = layer_arrays(CLASS_LAYERS[0], detail, head.input_offset, head.input_gain)
    for name, layer in zip(CLASS_LAYERS[1:], others, strict=True):
        arrays |= layer_arrays(name, layer)
    return arrays


def sample_weights(samples: Samples, frequency_strength: float) -> FloatArray:
    """(N,) weights of the loss: thinned classes get back this power of what thinning took."""
    return samples.weights**frequency_strength


def train_classifier(
    config: TrainConfig,
    training: Samples,
    validation: Samples,
    on_epoch: Callable[[EpochRecord, PatchNetwork], None] | None = None,
    checkpoint: Path | None = None,
) -> tuple[PatchNetwork, TrainingOutcome]:
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
    fitted, watched = (
        TrainingSet(part.patches, part.labels, sample_weights(part, config.frequency_strength))
        for part in (training, validation)
    )
    with fixed_threads():
        outcome = train_network(
            network,
            fitted,
            watched,
            find_optimizer(config.optimizer),
            StoppingRules(config.epochs, config.goal, config.min_gradient, config.max_fail),
            batch_size=config.batch_size,
            cosine_decay=config.cosine_decay,
            scaling=config.input_scaling.value,
            seed=config.seed,
            on_epoch=on_epoch,
            checkpoint=checkpoint,
            device=find_device(config.device.value),
        )
    return network, outcome
