"""What is told of the network while it learns, and how it does on scenes it never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from skipnet.learning import descriptor_scores as judging
from skipnet.learning.dataset import Samples
from skipnet.learning.descriptor import Descriptor
from skipnet.learning.descriptor_network import DescriptorNetwork
from skipnet.learning.descriptor_pairs import PatchPairs, TwoScans
from skipnet.learning.descriptor_training import Watch
from skipnet.types import IntArray
from skipnet.viz import dashboard

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

_LOGGED_STEPS = 50
_SHOWN_PLACES = 300
"""Places of one pair of scans whose descriptors TensorBoard's projector shows."""


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


def predict(descriptor: Descriptor, samples: Samples) -> IntArray:
    """(N,) the most probable class."""
    return descriptor.classify(samples.patches, samples.surroundings).argmax(axis=1)


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


def markdown_table(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """One line per descriptor and range of overlap."""
    head = "| descriptor | overlap | unseen pairs | inlier ratio | matched pairs | time (ms) |"
    lines = [head, "|---|---|---:|---:|---:|---:|"]
    for name, groups in scores.items():
        for overlap, figures_of in groups.items():
            figures = f"{figures_of['inlier_ratio']:.3f} | {figures_of['matched_pairs']:.3f}"
            cells = f"{figures_of['pairs']} | {figures} | {1000 * figures_of['seconds']:.0f}"
            lines.append(f"| {name} | {overlap} | {cells} |")
    return "\n".join(lines) + "\n"
