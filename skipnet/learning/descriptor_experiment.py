"""One descriptor: simulate, train, judge it beside FPFH on scenes it never saw, write it all."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.config import AugmentationConfig, DescriptorTrainConfig, TrainConfig
from skipnet.features.cylinders import LEVELS, REACH_VOXELS
from skipnet.learning import descriptor_scores as judging
from skipnet.learning import reports
from skipnet.learning.descriptor import (
    KEPT_SHARE,
    MAX_KEYPOINTS,
    SHIPPED_WEIGHTS,
    Descriptor,
    load_descriptor,
    save_descriptor,
)
from skipnet.learning.descriptor_network import DescriptorNetwork, Widths
from skipnet.learning.descriptor_pairs import (
    PatchPairs,
    Recipe,
    TwoScans,
    digest,
    make_patch_pairs,
    make_scans,
)
from skipnet.learning.descriptor_training import Outcome, Schedule, Watch, train_network
from skipnet.viz import dashboard

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

FIRST_SEED = {"training": 0, "validation": 10_000, "test": 20_000}
"""Scenes of the three sets never share a seed."""
CHECKPOINT = "checkpoint.pt"
_LOGGED_STEPS = 50
_SHOWN_PLACES = 300
"""Places of one pair of scans whose descriptors TensorBoard's projector shows."""


def train_descriptor(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    A run that was interrupted goes on from the checkpoint in that folder.

    Returns:
        The summary, as in summary.json: what training reached, the scores, the seconds it took.

    Raises:
        ValueError: settings that do not fit each other, or the checkpoint of another run.
    """
    folder, options = Path(config.output_dir), config.descriptor
    folder.mkdir(parents=True, exist_ok=True)
    reports.write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    training, validation, test = make_sets(options)
    seconds = {"data": time.perf_counter() - start_s}
    with dashboard.open_dashboard(folder / "tensorboard") as writer:
        watch = Progress(writer, [judging.Keypoints.of(scans) for scans in validation]).watch()
        outcome = train_network(training, *plan(options), config.seed, watch, folder / CHECKPOINT)
        seconds["training"] = time.perf_counter() - start_s - seconds["data"]
        path = folder / "descriptor.npz"
        card = make_card(config, training, outcome)
        save_descriptor(Descriptor(outcome.network.arrays(), card), path)
        descriptor = load_descriptor(path)  # judged as it will be used: rounded
        scores = judge_on_unseen(descriptor, test)
        log_embeddings(writer, descriptor, training[:4])
    card["scores"] = {name: groups["all"] for name, groups in scores.items()}
    for target in [path, SHIPPED_WEIGHTS] if config.ship else [path]:
        save_descriptor(Descriptor(descriptor.weights, card), target)
    summary = {
        "experiment": config.experiment_name,
        "seed": config.seed,
        "reached": reached(outcome),
        "unseen": scores,
        "seconds": seconds,
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    (folder / "scores.md").write_text(markdown_table(scores))
    return summary


def make_sets(
    options: DescriptorTrainConfig,
) -> tuple[list[PatchPairs], list[TwoScans], list[TwoScans]]:
    """Pairs of patches to train on, pairs of scans for validation and for the test."""

    def seeds(name: str) -> range:
        count: int = getattr(options, f"{name}_pairs")
        return range(FIRST_SEED[name], FIRST_SEED[name] + count)

    families, how, workers = options.families, recipe(options.augmentation), options.workers
    training = make_patch_pairs(
        families, seeds("training"), options.patches_per_scans, how, workers
    )
    return (
        training,
        make_scans(families, seeds("validation"), how, workers),
        make_scans(families, seeds("test"), how, workers),
    )


def recipe(options: AugmentationConfig) -> Recipe:
    """How scans become examples under this configuration."""
    values = dict(vars(options))
    return Recipe(**{**values, "noise_voxels": tuple(options.noise_voxels)})


def plan(options: DescriptorTrainConfig) -> tuple[Widths, Schedule]:
    """The network and the steps that the options ask for."""
    widths = Widths(options.sector_units, options.hidden_units, options.output_units)
    schedule = Schedule(
        steps=options.steps,
        scans_per_step=options.scans_per_step,
        pairs_per_scans=options.patches_per_step // options.scans_per_step,
        learning_rate=options.learning_rate,
        temperature=options.temperature,
        loss=options.loss.value,
        validate_every=options.validate_every,
        patience=options.patience,
    )
    return widths, schedule


@dataclass(frozen=True)
class Progress:
    """Shows in TensorBoard how training goes, and scores the network on unseen scans."""

    writer: SummaryWriter
    unseen: Sequence[judging.Keypoints]

    def watch(self) -> Watch:
        """What ``train_network`` reports to."""
        return Watch(score=self.score, on_step=self.log_loss)

    def log_loss(self, step: int, loss: float) -> None:
        """The loss, now and then."""
        if step % _LOGGED_STEPS == 0:
            dashboard.log_scalars(self.writer, {"loss/training": loss}, step)

    def score(self, step: int, network: DescriptorNetwork) -> float:
        """Mean inlier ratio on the unseen scans; also logged, with the share of matched pairs."""
        descriptor = Descriptor(network.arrays(), {})
        ratios = np.array([keypoints.inlier_ratio(descriptor) for keypoints in self.unseen])
        matched = (ratios >= judging.ENOUGH_INLIERS).mean()
        values = {
            "inlier_ratio/validation": float(ratios.mean()),
            "matched_pairs/validation": float(matched),
        }
        dashboard.log_scalars(self.writer, values, step)
        return float(ratios.mean())


def judge_on_unseen(
    descriptor: Descriptor, test: Sequence[TwoScans]
) -> dict[str, dict[str, dict[str, float]]]:
    """Scores of this descriptor and of FPFH on the same keypoints, in all and by overlap."""
    matches: dict[str, list[judging.Match]] = {"learned": [], "fpfh": []}
    for scans in test:
        keypoints = judging.keypoints_of(scans, descriptor)
        learned = partial(judging.by_network, descriptor=descriptor)
        matches["learned"].append(judging.match(scans, learned))
        fpfh = partial(judging.by_fpfh, keypoints=keypoints)
        if not matches["fpfh"]:
            fpfh(scans)  # what it imports is no part of its time
        matches["fpfh"].append(judging.match(scans, fpfh))
    return {
        name: {"all": judging.summarise(found), **judging.by_overlap(found)}
        for name, found in matches.items()
    }


def log_embeddings(
    writer: SummaryWriter, descriptor: Descriptor, training: Sequence[PatchPairs]
) -> None:
    """Descriptors for TensorBoard's projector: the two of one place shall lie side by side."""
    rows, labels = [], []
    for scene, pairs in enumerate(training):
        for scan, patches in (("source", pairs.source), ("target", pairs.target)):
            some = patches[:_SHOWN_PLACES].astype(np.float32)
            rows.append(descriptor(some))
            labels += [[f"{scene}", f"{place}", scan] for place in range(len(some))]
    dashboard.log_embedding(
        writer, "descriptors", np.concatenate(rows), labels, ["scene", "place", "scan"]
    )


def make_card(
    config: TrainConfig, training: Sequence[PatchPairs], outcome: Outcome
) -> dict[str, Any]:
    """What the weights are, without their scores."""
    return {
        "patch": {"levels": list(LEVELS), "reach_voxels": REACH_VOXELS},
        "keypoints": {"described": MAX_KEYPOINTS, "kept_share": KEPT_SHARE},
        "seed": config.seed,
        "training_data": {
            "origin": "simulation only: no real scan took part",
            "pairs_of_scans": len(training),
            "pairs_of_patches": sum(len(pairs) for pairs in training),
            "digest": digest(training),
        },
        "reached": reached(outcome),
        "config": reports.plain(config)["descriptor"],
    }


def reached(outcome: Outcome) -> dict[str, Any]:
    """Why training ended and where it was best."""
    return {
        "stop_reason": outcome.stop_reason,
        "best_step": outcome.best_step,
        "validation_inlier_ratio": outcome.best_score,
    }


def markdown_table(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """One line per descriptor and range of overlap."""
    head = "| descriptor | overlap | unseen pairs | inlier ratio | matched pairs | time (ms) |"
    lines = [head, "|---|---|---:|---:|---:|---:|"]
    for name, groups in scores.items():
        for overlap, score in groups.items():
            figures = f"{score['inlier_ratio']:.3f} | {score['matched_pairs']:.3f}"
            cells = f"{score['pairs']} | {figures} | {1000 * score['seconds']:.0f}"
            lines.append(f"| {name} | {overlap} | {cells} |")
    return "\n".join(lines) + "\n"
