"""Both heads: simulate, train, judge them on scenes they never saw, write it all.

The descriptor is judged beside FPFH, the classes beside a network trained for them alone.
"""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from skipnet.features.cylinders import KINDS, LEVELS, REACH_VOXELS
from skipnet.metrics import correspondences as judging
from skipnet.networks.catalog import load_network, rounded, save_network
from skipnet.networks.describing import KEPT_SHARE, classify_voxels
from skipnet.networks.devices import find_device
from skipnet.networks.model import Model
from skipnet.networks.names import SHIPPED_WEIGHTS
from skipnet.networks.numpy_network import SmallNetwork
from skipnet.parallel.pools import worker_pool
from skipnet.progress import tell
from skipnet.simulation.scenes.scenes import check_families
from skipnet.storage import write_config, write_text
from skipnet.training import reports
from skipnet.training.data.labelled import Samples
from skipnet.training.descriptor_options import DescriptorTrainConfig
from skipnet.training.experiments.classes_alone import check_settings, class_labelling
from skipnet.training.experiments.lessons import Sets, Unseen, make_sets, make_unseen
from skipnet.training.networks.cyclic import DescriptorNetwork, Widths
from skipnet.training.networks.perceptron import Classifier, classify, round_to_half
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.schedule import Schedule
from skipnet.training.scores import score, table_rows
from skipnet.training.tasks.classes import head_arrays, train_classifier, with_hidden
from skipnet.training.tasks.descriptor import DescriptorTask, Lessons, StepPlan
from skipnet.training.trainer import Outcome, Trainer
from skipnet.types import FloatArray
from skipnet.viz import dashboard

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

Trained = Outcome[DescriptorNetwork]
CHECKPOINT, CLASSES_CHECKPOINT = "checkpoint.pt", "classes_checkpoint.pt"


def train_both_heads(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    A run that was interrupted goes on from the checkpoint in that folder. The summary comes back,
    as in summary.json: what training reached, the scores, the seconds it took.

    Raises:
        ValueError: settings that do not fit each other, or the checkpoint of another run.
    """
    check_settings(config)
    check_families(config.descriptor.families)
    device, folder = find_device(config.device.value), Path(config.output_dir)
    if not (folder / "config.yaml").exists():
        write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    sets = make_sets(config)
    data_s = time.perf_counter()
    with dashboard.open_dashboard(folder / "tensorboard") as writer:
        outcome, weights, unseen, scores = learn(config, sets, writer, device)
        write_config(config, folder / "config.yaml")  # of the run that was gone on with
        trained_s = time.perf_counter()
        card = make_card(config, sets.lessons, outcome)
        tell("judging")
        path = folder / "descriptor.npz"
        save_network(weights, card, path)
        descriptor = load_network(path)  # judged as it will be used: rounded
        classes = {"both heads": judge_classes(config, descriptor, unseen.classes)}
        if config.compare_alone:
            classes["classes alone"] = classes_alone(config, sets, unseen.classes)
        reports.log_embeddings(writer, descriptor, sets.lessons.pairs[:4])
        log_outcome(writer, config, descriptor, {**scores, **classes})
    card["scores"] = {
        **{name: groups["all"] for name, groups in scores.items()},
        "classes": {name: groups["all"] for name, groups in classes.items()},
    }
    for target in [path, SHIPPED_WEIGHTS] if config.ship else [path]:
        save_network(weights, card, target)
    times_s = [start_s, data_s, trained_s, time.perf_counter()]
    seconds = dict(zip(("data", "training", "judging"), np.diff(times_s).tolist(), strict=True))
    summary = {
        "experiment": config.experiment_name,
        "seed": config.seed,
        "reached": reached(outcome),
        "unseen": scores,
        "classes": classes,
        "seconds": seconds,
    }
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    tables = reports.descriptor_table(scores) + "\n" + reports.markdown_table(table_rows(classes))
    write_text(folder / "scores.md", tables)
    return summary


def learn(
    config: TrainConfig, sets: Sets, writer: SummaryWriter, device: torch.device
) -> tuple[Trained, dict[str, FloatArray], Unseen, dict[str, dict[str, dict[str, float]]]]:
    """Train the descriptor, then the classes; another process does all that can wait meanwhile.

    Returns:
        What the descriptor's training reached, the weights of the whole network, the scenes to
        judge it on, simulated meanwhile, and the descriptor's scores on them.
    """
    with worker_pool(1) as aside:
        to_come = aside.submit(make_unseen, config)
        outcome = fit(config, sets, writer, device)
        tell("simulating what it is judged on")
        unseen = to_come.result()
        shared = SmallNetwork(rounded(outcome.network.arrays()), {})
        judged = aside.submit(reports.judge_on_unseen, shared, unseen.scans)
        head = fit_classes(config, sets, shared, writer)
        tell("judging")
        return outcome, shared.weights | head, unseen, judged.result()


def fit(config: TrainConfig, sets: Sets, writer: SummaryWriter, device: torch.device) -> Trained:
    """Train the shared layers and the descriptor."""
    options = config.descriptor
    torch.manual_seed(config.seed)
    shared = options.sector_units, options.hidden_units, options.output_units
    widths = Widths(*shared, *config.hidden_sizes)
    network = DescriptorNetwork(widths, config.dropout)
    unseen = [judging.Keypoints.of(scans, network.model()) for scans in sets.validation]
    return Trainer(
        DescriptorTask(sets.lessons, step_plan(options), unseen, config.seed),
        network,
        find_optimizer(config.optimizer),
        schedule(options),
        Path(config.output_dir) / CHECKPOINT,
        device,
        partial(reports.log_step, writer),
        partial(reports.log_round, writer),
    ).run()


def fit_classes(
    config: TrainConfig, sets: Sets, shared: SmallNetwork, writer: SummaryWriter
) -> dict[str, FloatArray]:
    """Train the class head upon the shared layers."""
    training, validation = (
        with_hidden(samples, shared) for samples in (sets.lessons.labelled, sets.validation_classes)
    )
    on_round = partial(reports.log_round, writer, group="classes/")
    checkpoint = Path(config.output_dir) / CLASSES_CHECKPOINT
    outcome = train_classifier(config, training, validation, on_round, checkpoint)
    return head_arrays(outcome.network.float())


def step_plan(options: DescriptorTrainConfig) -> StepPlan:
    """What a step shows under these options."""
    return StepPlan(
        scans=options.scans_per_step,
        pairs_per_scans=options.patches_per_step // options.scans_per_step,
        labelled=options.labelled_per_step,
        class_weight=options.class_weight,
        temperature=options.temperature,
        loss=options.loss.value,
    )


def schedule(options: DescriptorTrainConfig) -> Schedule:
    """The steps that the options ask for."""
    return Schedule(
        steps=options.steps,
        round_steps=options.validate_every,
        length=f"{options.steps} steps",
        rate="warm_cosine",
        max_fail=options.patience,
    )


def judge_classes(
    config: TrainConfig, descriptor: Model, test: Samples
) -> dict[str, dict[str, Any]]:
    """Scores of the class head, in all, by range and by family."""
    return score(test, reports.predict(descriptor, test), config.data.families)


def classes_alone(config: TrainConfig, sets: Sets, test: Samples) -> dict[str, dict[str, Any]]:
    """The same scores of a network that learns the classes alone, from the same patches."""
    outcome = train_classifier(config, sets.lessons.labelled, sets.validation_classes)
    alone = Classifier(round_to_half(outcome.network.float()), {})
    predicted = classify(alone, test.patches).argmax(axis=1)
    return score(test, predicted, config.data.families)


def log_outcome(
    writer: SummaryWriter,
    config: TrainConfig,
    descriptor: Model,
    scores: dict[str, dict[str, dict[str, float]]],
) -> None:
    """All options beside the final scores, and a Skip-map in 3D by the classes it is given."""
    descriptors = ("inlier_ratio", "matched_pairs")
    final = {
        f"{name} {measure}": groups["all"][measure]
        for name, groups in scores.items()
        for measure in (descriptors if "inlier_ratio" in groups["all"] else ("macro_f1",))
    }
    reports.log_parameters(writer, config, final)
    labelling = class_labelling(config.data)
    classes_of = partial(classify_voxels, network=descriptor)
    reports.log_skipmap(writer, labelling, classes_of, config.data.families[0])


def make_card(config: TrainConfig, lessons: Lessons, outcome: Trained) -> dict[str, Any]:
    """What the weights are, without their scores."""
    return {
        "architecture": SmallNetwork.architecture,
        "patch": {"levels": list(LEVELS), "reach_voxels": REACH_VOXELS, "kinds": KINDS},
        "keypoints": {"described": SmallNetwork.max_keypoints, "kept_share": KEPT_SHARE},
        "seed": config.seed,
        "training_data": {
            "origin": "simulation only: no real scan took part",
            "pairs_of_scans": len(lessons.pairs),
            "pairs_of_patches": sum(len(pairs) for pairs in lessons.pairs),
            "labelled_patches": len(lessons.labelled),
            "digest": lessons.digest(),
        },
        "reached": reached(outcome),
        "config": reports.for_card(config),
    }


def reached(outcome: Outcome[Any]) -> dict[str, Any]:
    """Why training ended and where it was best."""
    return {
        "stop_reason": outcome.stop_reason,
        "best_step": outcome.best.step,
        "validation_inlier_ratio": outcome.best.score,
    }
