"""What both heads learn from, are watched on while they learn, and are judged on: simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skipnet.metrics.correspondences import TwoScans
from skipnet.parallel.pools import Each, mapping
from skipnet.simulation.seeds import DESCRIPTOR_TEST, DESCRIPTOR_VALIDATION, TRAINING
from skipnet.training.data.labelled import Samples, make_samples
from skipnet.training.data.pairs import make_patch_pairs, make_scans
from skipnet.training.descriptor_options import DescriptorTrainConfig
from skipnet.training.experiments.class_samples import class_labelling, class_seeds
from skipnet.training.options import TrainConfig
from skipnet.training.tasks.classes import sample_weights
from skipnet.training.tasks.descriptor import Lessons

SEEDS = {"training": TRAINING, "validation": DESCRIPTOR_VALIDATION, "test": DESCRIPTOR_TEST}


@dataclass(frozen=True)
class Sets:
    """What the network learns from and is watched on."""

    lessons: Lessons
    validation: Sequence[TwoScans]
    validation_classes: Samples


@dataclass(frozen=True)
class Unseen:
    """What the network is judged on."""

    scans: Sequence[TwoScans]
    classes: Samples


def make_sets(config: TrainConfig) -> Sets:
    """Simulate what the network learns from and is watched on."""
    options = config.descriptor
    with mapping(config.data.workers) as each:
        pairs = make_patch_pairs(
            options.families,
            _seeds(options, "training"),
            options.patches_per_scans,
            options.augmentation,
            each,
        )
        classes = _labelled(config, "training", each)
        weights = sample_weights(classes, config.frequency_strength)
        return Sets(
            Lessons(pairs, classes, weights),
            _scans(options, "validation", each),
            _labelled(config, "validation", each),
        )


def make_unseen(config: TrainConfig) -> Unseen:
    """Simulate what it is judged on, in this process."""
    return Unseen(_scans(config.descriptor, "test", map), _labelled(config, "test", map))


def _seeds(options: DescriptorTrainConfig, name: str) -> range:
    """Of the pairs of scans of one set."""
    count: int = getattr(options, f"{name}_pairs")
    return SEEDS[name].take(count)


def _scans(options: DescriptorTrainConfig, name: str, each: Each) -> list[TwoScans]:
    """Pairs of scans of one set."""
    how = options.augmentation
    return make_scans(options.families, _seeds(options, name), how, each)


def _labelled(config: TrainConfig, name: str, each: Each) -> Samples:
    """Labelled patches of one set, with what is around them; of the test's none is left out."""
    sampled = class_labelling(config.data, thinned=name != "test", with_surroundings=True)
    return make_samples(config.data.families, class_seeds(config.data, name), sampled, each)
