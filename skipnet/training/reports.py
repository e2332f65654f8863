"""What an experiment writes: its run folder and its TensorBoard."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.geometry import transform_points
from skipnet.metrics import correspondences as judging
from skipnet.metrics.correspondences import TwoScans
from skipnet.networks.model import Model
from skipnet.progress import counted
from skipnet.simulation.seeds import CLASS_TEST
from skipnet.skipmap.skipmap import SkipMap
from skipnet.storage import replacing, write_text
from skipnet.training.data.labelled import Labelling, Samples, label_scene
from skipnet.training.data.pairs import PatchPairs
from skipnet.training.options import NetworkKind, TrainConfig
from skipnet.training.schedule import Record
from skipnet.training.scores import CLASS_NAMES, table_rows
from skipnet.training.task import Judgement
from skipnet.types import FeatureClass, FloatArray, IntArray
from skipnet.viz import dashboard, pictures
from skipnet.viz.views import png_bytes

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

PICTURE_SEED = CLASS_TEST.scene(0)
"""Scene of the Skip-maps in TensorBoard: the first one of the test."""
_DRAWN_ROUNDS = 10
"""The confusion matrix is drawn every so many rounds."""
_LOGGED_STEPS = 50
_SHOWN_PLACES = 300
"""Places of one pair of scans whose descriptors TensorBoard's projector shows."""


def plain(config: TrainConfig) -> dict[str, Any]:
    """The configuration as nested dicts of plain values."""
    from omegaconf import OmegaConf

    container = OmegaConf.to_container(OmegaConf.structured(config), enum_to_str=True)
    return dict(container)  # type: ignore[arg-type]


def for_card(config: TrainConfig) -> dict[str, Any]:
    """As ``plain``, without what the weights do not depend on."""
    own = {NetworkKind.deep: {"deep"}, NetworkKind.matcher: {"matcher"}}
    parts = {"descriptor", "data", "deep", "matcher"}
    others = parts - own.get(config.network, {"descriptor", "data"}) | {"output_dir", "terminal"}
    return {name: value for name, value in plain(config).items() if name not in others}


def log_round(writer: SummaryWriter, record: Record, judgement: Judgement, group: str = "") -> None:
    """The training's loss, all figures of the validation set and, now and then, the confusion.

    What takes long also says on the terminal how far it is.
    ``group`` comes before every name, to tell them from those of another training in one folder.
    """
    number = record.step if judgement.confusion is None else record.round
    values = {"loss/training": record.training_loss, **judgement.figures}
    dashboard.log_scalars(writer, {f"{group}{n}": value for n, value in values.items()}, number)
    if judgement.confusion is None:
        print(f"step {record.step}: {', '.join(f'{n} {v:.4g}' for n, v in values.items())}")
    drawn = record.round % _DRAWN_ROUNDS == 0 and record.round <= 10 * _DRAWN_ROUNDS
    if judgement.confusion is not None and drawn:
        figure = pictures.draw_confusion_matrix(judgement.confusion, CLASS_NAMES)
        dashboard.log_figure(writer, f"{group}confusion/validation", figure, number)


def log_step(writer: SummaryWriter, step: int, loss: float) -> None:
    """The loss of a batch, now and then."""
    if step % _LOGGED_STEPS == 0:
        dashboard.log_scalars(writer, {"loss/batch": loss}, step)


def log_parameters(writer: SummaryWriter, config: TrainConfig, scores: Mapping[str, float]) -> None:
    """The run's row among the hyper-parameters: all options, and what came of them at the end."""
    parameters = {"experiment": config.experiment_name, **for_card(config)}
    final = {f"hparam/{name}": score for name, score in scores.items()}
    dashboard.log_hyperparameters(writer, parameters, final)


def log_skipmap(
    writer: SummaryWriter,
    labelling: Labelling,
    classes_of: Callable[[SkipMap, IntArray], FloatArray],
    family: str,
) -> None:
    """The Skip-map of a test scan in 3D: by curvature, by true class, by the network's class.

    Args:
        writer: to write to.
        labelling: how the scan becomes samples.
        classes_of: (K, 5) probabilities of the classes of (K,) voxels of a Skip-map.
        family: of the scene.
    """
    scan = label_scene(family, PICTURE_SEED, labelling, np.random.default_rng(PICTURE_SEED))[0]
    centroids_m = scan.skipmap.centroids_m
    dashboard.log_skipmap_by_curvature(
        writer, "skipmap/curvature", centroids_m, scan.skipmap.curvatures
    )
    predicted = classes_of(scan.skipmap, scan.voxels).argmax(axis=1)
    for name, labels in (("true_class", scan.labels), ("network_class", predicted)):
        classes = np.full(len(centroids_m), int(FeatureClass.PLANE))
        classes[scan.voxels] = labels
        dashboard.log_skipmap_by_class(writer, f"skipmap/{name}", centroids_m, classes)


def log_two_scans(writer: SummaryWriter, scans: TwoScans) -> None:
    """A pair of scans as it was aligned, in 3D: the voxels of each by their curvature."""
    source_m = transform_points(scans.T_target_source, scans.source.centroids_m)
    for name, centroids_m, skipmap in (
        ("source", source_m, scans.source),
        ("target", scans.target.centroids_m, scans.target),
    ):
        dashboard.log_skipmap_by_curvature(writer, f"pair/{name}", centroids_m, skipmap.curvatures)


def write_results(
    folder: Path, summary: Mapping[str, Any], scores: Mapping[str, Any], counts: IntArray
) -> None:
    """summary.json, scores.csv, scores.md and the confusion matrix as a picture."""
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    rows = table_rows(scores)
    with replacing(folder / "scores.csv") as path, open(path, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    write_text(folder / "scores.md", markdown_table(rows))
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    figure = pictures.draw_confusion_matrix(counts, CLASS_NAMES)
    (figures / "confusion.png").write_bytes(png_bytes(figure))


def markdown_table(rows: list[dict[str, Any]]) -> str:
    """One line per classifier and group: voxels, accuracy, macro-F1 and the F1 of every class."""
    names = ["macro_f1", *(f"f1_{name}" for name in CLASS_NAMES), "accuracy"]
    heads = ["classifier", "scenes never seen", "voxels", *names]
    lines = ["| " + " | ".join(heads) + " |", "|---|---|" + "---:|" * (len(heads) - 2)]
    for row in rows:
        cells = [row["classifier"], row["group"], str(row["voxels"])]
        cells += ["-" if np.isnan(row[name]) else f"{row[name]:.3f}" for name in names]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def judge_on_unseen(
    descriptor: Model, test: Sequence[TwoScans]
) -> dict[str, dict[str, dict[str, float]]]:
    """Scores of this descriptor and of FPFH on the same keypoints, in all and by overlap."""
    matches: dict[str, list[judging.Match]] = {"learned": [], "fpfh": []}
    for scans in counted("pairs to judge on", test, len(test)):
        keypoints = judging.keypoints_of(scans, descriptor)
        learned = partial(judging.by_network, descriptor=descriptor)
        matches["learned"].append(judging.match(scans, learned))
        fpfh = partial(judging.by_fpfh, keypoints=keypoints)
        if not matches["fpfh"]:
            fpfh(scans)  # what it imports is no part of its time
        matches["fpfh"].append(judging.match(scans, fpfh))
    return {name: judging.summarise_by_overlap(found) for name, found in matches.items()}


def predict(descriptor: Model, samples: Samples) -> IntArray:
    """(N,) the most probable class."""
    return descriptor.classify(samples.patches, samples.surroundings).argmax(axis=1)


def log_embeddings(
    writer: SummaryWriter, descriptor: Model, training: Sequence[PatchPairs]
) -> None:
    """Descriptors for TensorBoard's projector: the two of one place shall lie side by side."""
    rows, labels = [], []
    for scene, pairs in enumerate(training):
        for scan, patches in (("source", pairs.source), ("target", pairs.target)):
            some = patches[:_SHOWN_PLACES].astype(np.float32)
            rows.append(descriptor.read(some)[0])
            labels += [[f"{scene}", f"{place}", scan] for place in range(len(some))]
    dashboard.log_embedding(
        writer, "descriptors", np.concatenate(rows), labels, ["scene", "place", "scan"]
    )


def descriptor_table(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """One line per descriptor and range of overlap."""
    head = "| descriptor | overlap | unseen pairs | inlier ratio | matched pairs | time (ms) |"
    lines = [head, "|---|---|---:|---:|---:|---:|"]
    for name, groups in scores.items():
        for overlap, figures_of in groups.items():
            figures = f"{figures_of['inlier_ratio']:.3f} | {figures_of['matched_pairs']:.3f}"
            cells = f"{figures_of['pairs']} | {figures} | {1000 * figures_of['seconds']:.0f}"
            lines.append(f"| {name} | {overlap} | {cells} |")
    return "\n".join(lines) + "\n"
