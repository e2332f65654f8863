"""The class head: learned last, with the layers that it shares with the descriptor held fixed.

Then the hidden units of a labelled patch are numbers like its 125 cells, read off once, and the
head learns as a network for the classes alone does (``experiment.train_classifier``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from torch import nn

from skipnet.config import TrainConfig
from skipnet.learning.dataset import Samples
from skipnet.learning.descriptor import CLASS_LAYERS, Descriptor
from skipnet.learning.descriptor_network import layer_arrays
from skipnet.learning.experiment import train_classifier
from skipnet.learning.network import PatchNetwork
from skipnet.learning.training import EpochRecord
from skipnet.types import FloatArray


def with_hidden(samples: Samples, shared: Descriptor) -> Samples:
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
    """The layers as ``Descriptor`` takes them."""
    detail, *others = (layer for layer in head.layers if isinstance(layer, nn.Linear))
    arrays = layer_arrays(CLASS_LAYERS[0], detail, head.input_offset, head.input_gain)
    for name, layer in zip(CLASS_LAYERS[1:], others, strict=True):
        arrays |= layer_arrays(name, layer)
    return arrays
