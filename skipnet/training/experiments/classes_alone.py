"""The classes alone: make the data, train, judge on unseen scenes, write it all."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.features.patches import build_patches
from skipnet.metrics.classes import confusion_matrix, macro_f1
from skipnet.networks.devices import find_device
from skipnet.parallel.pools import mapping
from skipnet.progress import tell
from skipnet.simulation.scanning.scanner import find_scanner
from skipnet.simulation.scenes.scenes import check_families
from skipnet.simulation.seeds import CLASS_TEST, CLASS_VALIDATION, TRAINING
from skipnet.skipmap.skipmap import SkipMap
from skipnet.storage import write_config
from skipnet.training import reports
from skipnet.training.data.labelled import Labelling, Samples, make_samples, thin
from skipnet.training.data.labels import LabelRule
from skipnet.training.data.options import DataConfig, Split
from skipnet.training.experiments.peers import COMPARED_VOXELS, predict_with_peers
from skipnet.training.networks.perceptron import (
    Classifier,
    PatchNetwork,
    classify,
    round_to_half,
    save_classifier,
)
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.scores import CLASS_NAMES, score
from skipnet.training.tasks.classes import sample_weights, train_classifier
from skipnet.training.trainer import Outcome
from skipnet.types import FeatureClass, FloatArray, IntArray
from skipnet.viz import dashboard
from skipnet.viz.dashboard import open_dashboard

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

SEEDS = {"training": TRAINING, "validation": CLASS_VALIDATION, "test": CLASS_TEST}
CHECKPOINT = "checkpoint.pt"
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


def run_experiment(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    Returns:
        The summary, as in summary.json: what training reached, scores, seconds of each part.

    Raises:
        ValueError: settings that do not fit each other.
    """
    check_settings(config)
    folder = Path(config.output_dir)
    if not (folder / "config.yaml").exists():
        write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    sets = make_sets(config)
    seconds = {"data": time.perf_counter() - start_s}
    with open_dashboard(folder / "tensorboard") as writer:
        on_round = partial(reports.log_round, writer)
        outcome = train_classifier(
            config, sets.training, sets.validation, on_round, folder / CHECKPOINT
        )
        write_config(config, folder / "config.yaml")  # of the run that was gone on with
        seconds["training"] = time.perf_counter() - start_s - seconds["data"]
        classifier = Classifier(
            round_to_half(outcome.network.float()), make_card(config, sets, outcome)
        )
        predicted = predict(classifier, sets.unseen.patches)
        scores = {"network": score(sets.unseen, predicted, config.data.families)}
        if config.compare_sklearn:
            scores |= compare(config, sets, classifier, seconds)
        summary = summarise(config, sets, classifier, outcome, scores, seconds)
        counts = confusion_matrix(sets.unseen.labels, predicted)
        reports.write_results(folder, summary, scores, counts)
        log_results(writer, config, summary, counts)
        tell("drawing")
        labelling = class_labelling(config.data)

        def classes_of(skipmap: SkipMap, voxels: IntArray) -> FloatArray:
            """Probabilities of the classes."""
            return classify(classifier, build_patches(skipmap, voxels, labelling.patch))

        reports.log_skipmap(writer, labelling, classes_of, config.data.families[0])
    save_classifier(classifier, folder / "classifier.pt")
    return summary


def log_results(
    writer: SummaryWriter, config: TrainConfig, summary: Mapping[str, Any], counts: IntArray
) -> None:
    """The confusion matrix of the unseen scenes, and the run's row among the hyper-parameters."""
    dashboard.log_confusion_matrix(writer, "unseen", counts, CLASS_NAMES)
    unseen = summary["unseen"]["network"]
    reports.log_parameters(writer, config, {n: unseen[n] for n in ("macro_f1", "accuracy")})


def check_settings(config: TrainConfig) -> None:
    """Refuse what cannot be trained, before anything is simulated.

    Raises:
        ValueError: a family, scanner, optimiser or device that does not exist.
    """
    check_families(config.data.families)
    find_scanner(config.data.scanner)
    find_optimizer(config.optimizer)
    find_device(config.device.value)


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


def compare(
    config: TrainConfig, sets: Sets, classifier: Classifier, seconds: dict[str, float]
) -> dict[str, Any]:
    """Scores of the network and of scikit-learn's classifiers on the same voxels of unseen scenes.

    The seconds that each took to train are added to ``seconds``.
    """
    rng = np.random.default_rng(config.seed)
    count = min(len(sets.unseen), COMPARED_VOXELS)
    voxels = sets.unseen[np.sort(rng.choice(len(sets.unseen), count, replace=False))]
    weights = sample_weights(sets.training, config.frequency_strength)
    predicted, peer_seconds = predict_with_peers(
        sets.training, weights, voxels.patches, config.seed
    )
    seconds |= peer_seconds
    predicted = {"network, same voxels": predict(classifier, voxels.patches), **predicted}
    return {name: score(voxels, p, config.data.families) for name, p in predicted.items()}


def predict(classifier: Classifier, patches: FloatArray) -> IntArray:
    """(N,) the most probable class."""
    return classify(classifier, patches).argmax(axis=1)


def make_card(config: TrainConfig, sets: Sets, outcome: Outcome[PatchNetwork]) -> dict[str, Any]:
    """What the weights are, without their scores: ``summarise`` adds them."""
    return {
        "hidden_sizes": list(config.hidden_sizes),
        "activation": config.activation.value,
        "patch": config.data.patch.value,
        "seed": config.seed,
        "training_data": {"samples": len(sets.training), "digest": sets.training.digest()},
        "test_data": {"samples": len(sets.unseen), "digest": sets.unseen.digest()},
        "stop_reason": outcome.stop_reason,
        "config": reports.for_card(config),
    }


def summarise(
    config: TrainConfig,
    sets: Sets,
    classifier: Classifier,
    outcome: Outcome[PatchNetwork],
    scores: dict[str, Any],
    seconds: dict[str, float],
) -> dict[str, Any]:
    """What training reached and how well the network does; its scores also go onto the card."""
    reached = {
        "stop_reason": outcome.stop_reason,
        "epochs": outcome.history[-1].round,
        "best_epoch": outcome.best.round,
        "training_loss": outcome.best.training_loss,
        "validation_loss": -outcome.best.score,
        "last_training_loss": outcome.history[-1].training_loss,
    }
    parts = {"training": sets.training, "validation": sets.validation, "held_out": sets.held_out}
    for name, part in parts.items():
        if part is not None and len(part):
            counts = confusion_matrix(part.labels, predict(classifier, part.patches))
            reached[f"{name}_accuracy"] = float(np.trace(counts) / counts.sum())
            reached[f"{name}_macro_f1"] = macro_f1(counts)
    classifier.card["scores"] = {"reached": reached, "unseen": scores["network"]["all"]}
    return {
        "experiment": config.experiment_name,
        "seed": config.seed,
        "samples": {"training": len(sets.training), "unseen": len(sets.unseen)},
        "reached": reached,
        "unseen": {name: groups["all"] for name, groups in scores.items()},
        "seconds": seconds,
    }
