"""What the classes are learned from and judged on: labelled voxels of simulated scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.parallel.pools import mapping
from skipnet.simulation.seeds import CLASS_TEST, CLASS_VALIDATION, TRAINING
from skipnet.training.data.labelled import Labelling, Samples, make_samples, thin
from skipnet.training.data.labels import LabelRule
from skipnet.training.data.options import DataConfig, Split
from skipnet.training.options import TrainConfig
from skipnet.types import FeatureClass, IntArray

SEEDS = {"training": TRAINING, "validation": CLASS_VALIDATION, "test": CLASS_TEST}
RANDOM_SHARES = (0.70, 0.15, 0.15)
"""Training, validation and test of a random split (MATLAB's dividerand)."""


@dataclass(frozen=True)
class Sets:
    """What an experiment learns from and is judged on."""

    training: Samples
    validation: Samples
    unseen: Samples
    """All feature voxels of the test scenes."""
    held_out: Samples | None
    """The test part of a random split: other voxels of the training scenes."""


def class_labelling(
    data: DataConfig, thinned: bool = False, with_surroundings: bool = False
) -> Labelling:
    """How scans become samples under this configuration."""
    label = data.label
    return Labelling(
        scanner=data.scanner,
        patch=data.patch.value,
        rule=LabelRule(label.radius_voxels, label.min_area_voxels2, label.min_beams),
        turn_second_scan=data.turn_second_scan,
        most_per_class=data.most_per_class if thinned else None,
        with_surroundings=with_surroundings,
    )


def class_seeds(data: DataConfig, name: str) -> range:
    """Of the scenes of the training, validation or test set."""
    count: int = getattr(data, f"{name}_scenes")
    return SEEDS[name].take(count)


def make_sets(config: TrainConfig) -> Sets:
    """Simulate and label the scenes, and split them."""
    data = config.data

    def scenes(name: str, thinned: bool) -> Samples:
        """The samples of one set."""
        how = class_labelling(data, thinned)
        return make_samples(data.families, class_seeds(data, name), how, each)

    with mapping(data.workers) as each:
        training = scenes("training", thinned=True)
        unseen = scenes("test", thinned=False)
        by_scene = data.split is Split.by_scene
        validation = scenes("validation", thinned=True) if by_scene else None
    rng = np.random.default_rng(config.seed)
    if data.samples is not None:
        training = draw_evenly(training, data.samples, rng)
    if validation is not None:
        return Sets(training, validation, unseen, held_out=None)
    parts = split_at_random(len(training), RANDOM_SHARES, rng)
    return Sets(training[parts[0]], training[parts[1]], unseen, training[parts[2]])


def draw_evenly(samples: Samples, count: int, rng: np.random.Generator) -> Samples:
    """``count`` samples at random, the same number of each class.

    Raises:
        ValueError: a class has too few, or ``count`` is no multiple of the number of classes.
    """
    most, rest = divmod(count, len(FeatureClass))
    rows, _ = thin(samples.labels, most, rng)
    if rest or len(rows) != count:
        have = np.bincount(samples.labels, minlength=len(FeatureClass)).tolist()
        raise ValueError(
            f"cannot draw {count} samples evenly from classes of {have} voxels; "
            "give a multiple of 5, or more data.training_scenes"
        )
    return samples[rows]


def split_at_random(
    count: int, shares: Sequence[float], rng: np.random.Generator
) -> list[IntArray]:
    """Rows 0 to ``count`` in disjoint random parts of the given shares, which sum to 1."""
    ends = np.round(np.cumsum(shares) * count).astype(np.int64)
    return [np.sort(part) for part in np.split(rng.permutation(count), ends[:-1])]
