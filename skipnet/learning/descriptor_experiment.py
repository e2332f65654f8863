"""One descriptor: simulate, train, judge it beside FPFH on scenes it never saw, write it all."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from skipnet.config import DescriptorTrainConfig, TrainConfig
from skipnet.features.cylinders import LEVELS, REACH_VOXELS, choose_keypoints
from skipnet.features.descriptors import fpfh, mutual_nearest
from skipnet.geometry import transform_points
from skipnet.learning import reports
from skipnet.learning.descriptor import (
    MAX_KEYPOINTS,
    SHIPPED_WEIGHTS,
    Descriptor,
    correspond,
    load_descriptor,
    save_descriptor,
)
from skipnet.learning.descriptor_pairs import (
    PatchPairs,
    TwoScans,
    digest,
    make_patch_pairs,
    simulate_two_scans,
)
from skipnet.learning.descriptor_training import DescriptorNetwork, Schedule, Widths, train_network
from skipnet.types import IntArray
from skipnet.viz import dashboard

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

FIRST_SEED = {"training": 0, "validation": 10_000, "test": 20_000}
"""Scenes of the three sets never share a seed."""
INLIER_VOXELS = 2.0
"""A correspondence is right when the truth brings its voxels nearer than this."""
ENOUGH_INLIERS = 0.05
"""Share of right correspondences from which two scans count as matched (PPFNet, CVPR 2018)."""
_LOGGED_STEPS, _VALIDATED_STEPS = 50, 500


def train_descriptor(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    Returns:
        The summary, as in summary.json: what training reached, the scores, the seconds it took.

    Raises:
        ValueError: settings that do not fit each other.
    """
    folder, options = Path(config.output_dir), config.descriptor
    folder.mkdir(parents=True, exist_ok=True)
    reports.write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    training = _patch_pairs("training", options.training_pairs, options)
    validation = _patch_pairs("validation", options.validation_pairs, options)
    seconds = {"data": time.perf_counter() - start_s}
    with dashboard.open_dashboard(folder / "tensorboard") as writer:
        watch = partial(log_step, writer, validation)
        network = train_network(training, *plan(options), config.seed, watch)
    seconds["training"] = time.perf_counter() - start_s - seconds["data"]
    path = folder / "descriptor.npz"
    save_descriptor(Descriptor(network.arrays(), make_card(config, training)), path)
    descriptor = load_descriptor(path)  # judged as it will be used: rounded
    descriptor.card["scores"] = scores = judge_on_unseen(descriptor, options)
    save_descriptor(descriptor, path)
    if config.ship:
        save_descriptor(descriptor, SHIPPED_WEIGHTS)
    summary = {
        "experiment": config.experiment_name,
        "seed": config.seed,
        "reached": {"stop_reason": f"all {options.steps} steps done"},
        "unseen": scores,
        "seconds": seconds,
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    (folder / "scores.md").write_text(markdown_table(scores))
    return summary


def plan(options: DescriptorTrainConfig) -> tuple[Widths, Schedule]:
    """The network and the steps that the options ask for."""
    widths = Widths(options.hidden_units, options.output_units)
    schedule = Schedule(
        steps=options.steps,
        scans_per_step=options.scans_per_step,
        pairs_per_scans=options.patches_per_step // options.scans_per_step,
        learning_rate=options.learning_rate,
        temperature=options.temperature,
    )
    return widths, schedule


def _patch_pairs(name: str, count: int, options: DescriptorTrainConfig) -> list[PatchPairs]:
    seeds = range(FIRST_SEED[name], FIRST_SEED[name] + count)
    return make_patch_pairs(options.families, seeds, options.patches_per_scans, options.workers)


def log_step(
    writer: SummaryWriter,
    validation: Sequence[PatchPairs],
    step: int,
    loss: float,
    network: DescriptorNetwork,
) -> None:
    """The loss, and now and then the share of unseen patches whose nearest is their partner."""
    if step % _LOGGED_STEPS == 0:
        dashboard.log_scalars(writer, {"loss/training": loss}, step)
    if step % _VALIDATED_STEPS == 0:
        found = [recognised(network, pairs) for pairs in validation]
        dashboard.log_scalars(writer, {"recognised/validation": float(np.mean(found))}, step)


@torch.no_grad()
def recognised(network: DescriptorNetwork, pairs: PatchPairs) -> float:
    """Share of the source's patches whose nearest among the target's shows the same place."""
    source, target = (network(torch.from_numpy(p).float()) for p in (pairs.source, pairs.target))
    nearest = (source @ target.T).argmax(dim=1).numpy()
    apart = np.linalg.norm(pairs.places[nearest] - pairs.places, axis=1)
    return float((apart < INLIER_VOXELS).mean())


def judge_on_unseen(
    descriptor: Descriptor, options: DescriptorTrainConfig
) -> dict[str, dict[str, float]]:
    """Mean inlier ratio and share of matched pairs on test scenes, of this descriptor and FPFH."""
    ratios: dict[str, list[float]] = {"learned": [], "fpfh": []}
    for seed in range(FIRST_SEED["test"], FIRST_SEED["test"] + options.test_pairs):
        scans = simulate_two_scans(options.families[seed % len(options.families)], seed)
        if scans is None:
            continue
        rows_s, rows_t, _ = correspond(scans.source, scans.target, descriptor)
        ratios["learned"].append(inlier_ratio(scans, rows_s, rows_t))
        ratios["fpfh"].append(inlier_ratio(scans, *_correspond_by_fpfh(scans)))
    return {
        name: {
            "inlier_ratio": float(np.mean(values)),
            "matched_pairs": float(np.mean(np.array(values) >= ENOUGH_INLIERS)),
            "pairs": len(values),
        }
        for name, values in ratios.items()
    }


def _correspond_by_fpfh(scans: TwoScans) -> tuple[IntArray, IntArray]:
    """FPFH's correspondences between the same keypoints."""
    keypoints = [choose_keypoints(scan, MAX_KEYPOINTS) for scan in (scans.source, scans.target)]
    of_source, of_target, _ = mutual_nearest(
        fpfh(scans.source)[keypoints[0]], fpfh(scans.target)[keypoints[1]]
    )
    return keypoints[0][of_source], keypoints[1][of_target]


def inlier_ratio(scans: TwoScans, rows_s: IntArray, rows_t: IntArray) -> float:
    """Share of correspondences that are right; 0 when there are none."""
    if len(rows_s) == 0:
        return 0.0
    moved_m = transform_points(scans.T_target_source, scans.source.centroids_m[rows_s])
    apart_m = np.linalg.norm(moved_m - scans.target.centroids_m[rows_t], axis=1)
    return float((apart_m < INLIER_VOXELS * scans.source.voxel_size_m).mean())


def make_card(config: TrainConfig, training: Sequence[PatchPairs]) -> dict[str, Any]:
    """What the weights are, without their scores."""
    return {
        "patch": {"levels": list(LEVELS), "reach_voxels": REACH_VOXELS},
        "seed": config.seed,
        "training_data": {
            "origin": "simulation only: no real scan took part",
            "pairs_of_scans": len(training),
            "pairs_of_patches": sum(len(pairs) for pairs in training),
            "digest": digest(training),
        },
        "config": reports.plain(config)["descriptor"],
    }


def markdown_table(scores: dict[str, dict[str, float]]) -> str:
    """One line per descriptor."""
    lines = ["| descriptor | unseen pairs | inlier ratio | matched pairs |", "|---|---:|---:|---:|"]
    for name, score in scores.items():
        cells = f"{score['pairs']} | {score['inlier_ratio']:.3f} | {score['matched_pairs']:.3f}"
        lines.append(f"| {name} | {cells} |")
    return "\n".join(lines) + "\n"
