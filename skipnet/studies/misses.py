"""Why were pairs missed? ``skipnet study misses run=RUN_FOLDER``.

For each pair that skipnet missed in a run of ``evaluate.py``: how many right correspondences the
descriptor offered, what the judge says of the reference pose, after fine alignment, and what of the
answer, and a picture of both. If the reference scores higher, no generator proposed it; otherwise
the scans themselves speak for the answer, as far as the judge can tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.reporting.pages import ReportFigure
from skipnet.benchmark.reporting.pair_views import pair_view
from skipnet.benchmark.running.runner import PREDICTIONS_FILE
from skipnet.benchmark.running.setup import make_pair_set, protocol_of
from skipnet.benchmark.scoring.predictions import Prediction, read_predictions
from skipnet.benchmark.scoring.protocols import right_by_rule
from skipnet.geometry import invert, transform_points
from skipnet.metrics.correspondences import INLIER_VOXELS
from skipnet.metrics.poses import measured_overlap, score_pose
from skipnet.networks.describing import correspond
from skipnet.registration.alignment.refinement import refine
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import Score
from skipnet.registration.options import RegistrationConfig
from skipnet.scans.describing import describe
from skipnet.scans.scan import Scan
from skipnet.studies.options import MissesConfig
from skipnet.studies.study import report
from skipnet.types import FloatArray, Pair
from skipnet.viz.tables import Table

if TYPE_CHECKING:
    from skipnet.viz.dots import DotPicture

MOST_VIEWS = 12
"""Misses that are shown in 3-D too, so that the page stays below 10 MB."""
OUR_DATASETS = "skipnet.benchmark.datasets."
"""Where the data sets lie that a run of anyone may name."""
HEADERS = (
    *("pair", "overlap", "status", "inliers offered"),
    *("reference: overlap", "violation", "score", "answer: overlap", "violation", "score", "why"),
)

NOTE = (
    "Overlap beside the pair: share of the source's voxels that the target has. Both poses: what "
    "the judge says of them. Not proposed: it would have taken the reference pose."
)


@dataclass(frozen=True)
class Miss:
    """What is known about a pair that was missed."""

    pair: Pair
    overlap: float
    """Share of the source's voxels that the target has, by the truth."""
    answer: Prediction
    inliers: int
    """Correspondences of the learned descriptor that the truth brings within two voxels ..."""
    correspondences: int
    """... out of so many."""
    score: Score
    """Of the reference pose after fine alignment, and of the answer, in this order."""

    @property
    def was_offered_too_little(self) -> bool:
        """The judge would have taken the reference pose, had a generator proposed it."""
        reference, answer = self.score.total
        return bool(reference > answer)

    @property
    def row(self) -> tuple[str, ...]:
        """Cells under ``HEADERS``."""
        columns = (self.score.overlap, self.score.violation, self.score.total)
        reference, answer = (
            (f"{o[i]:.1%}", f"{v[i]:.2%}", f"{t[i]:.3f}") for i in (0, 1) for o, v, t in [columns]
        )
        why = "not proposed" if self.was_offered_too_little else "the answer fits better"
        found = f"{self.inliers} of {self.correspondences}"
        head = (self.pair.name, f"{self.overlap:.0%}", self.answer.status, found)
        return (*head, *reference, *answer, why)

    def view(self) -> str:
        """Both scans in 3-D: as answered, with the residuals, in truth, and before."""
        T_answer = self.answer.pose("fine")
        assert T_answer is not None
        return pair_view(self.pair, T_answer)

    def draw(self) -> DotPicture:
        """Both scans under the reference pose, and under the answer."""
        from skipnet.viz.pictures import draw_before_after

        T_answer = self.answer.pose("fine")
        assert T_answer is not None
        pair = self.pair
        moved_m = transform_points(pair.T_target_source, np.asarray(pair.source_m, np.float64))
        picture = draw_before_after(moved_m, pair.target_m, T_answer @ invert(pair.T_target_source))
        return picture.retitled("before", "reference").retitled("after", "answer")


def run(config: MissesConfig) -> dict[str, Any]:
    """Look into every miss of a run and report, with a picture of each; the summary comes back."""
    misses = list(find_misses(Path(str(config.run)), config.method))
    unproposed = sum(miss.was_offered_too_little for miss in misses)
    figures = [
        ReportFigure(
            _file_name(miss),
            f"{miss.pair.name}: {miss.row[-1]}",
            miss.draw(),
            miss.view() if number < MOST_VIEWS else "",
        )
        for number, miss in enumerate(misses)
    ]
    return report(
        config,
        "Misses: why were pairs missed?",
        {"run": str(config.run), "method": config.method},
        [Table("Every miss", HEADERS, tuple(miss.row for miss in misses), NOTE)],
        figures,
        [f"{len(misses)} misses; in {unproposed} the judge would have taken the reference pose."],
        misses=[
            {"pair": m.pair.name, "overlap": m.overlap, "status": m.answer.status, "why": m.row[-1]}
            for m in misses
        ],
    )


def _file_name(miss: Miss) -> str:
    return miss.pair.name.replace("/", "_").replace(", ", "_")


def _config_of(path: Path) -> EvaluateConfig:
    """The options of a run, which may be a stranger's: they name data, and no code but ours."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    try:
        found = OmegaConf.merge(OmegaConf.structured(EvaluateConfig), OmegaConf.load(path))
        config: EvaluateConfig = OmegaConf.to_object(found)  # type: ignore[assignment]
    except (YAMLError, OmegaConfBaseException, OSError, ValueError, RecursionError) as error:
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: no options of evaluate.py: {message}") from error
    if not config.dataset.startswith(OUR_DATASETS):
        raise ValueError(f"{path}: dataset={config.dataset}: expected one of {OUR_DATASETS}*")
    return config


def find_misses(folder: Path, method: str = "skipnet") -> Iterator[Miss]:
    """The pairs of a run for which a method gave a wrong pose, each looked into.

    Args:
        folder: of the run; its ``config.yaml`` says which pairs they were.
        method: whose answers to look at; the descriptor and the judge are skipnet's.

    Raises:
        ValueError: no run, or no answers of the method, are in the folder.
    """
    if not (folder / "config.yaml").is_file():
        raise ValueError(f"{folder} holds no run of evaluate.py: expected a config.yaml there")
    config = _config_of(folder / "config.yaml")
    answers = {p.pair: p for p in read_predictions(folder / PREDICTIONS_FILE) if p.method == method}
    if not answers:
        raise ValueError(f"{folder} holds no answers of {method}: take a run that has some")
    pair_set, rule = make_pair_set(config), protocol_of(config).name
    for index, name in enumerate(pair_set.names):
        answer = answers.get(name)
        if answer is None or answer.T_target_source is None:
            continue
        pair = pair_set.load(index)
        if not right_by_rule(score_pose(answer.pose("fine"), pair), pair).get(rule, True):
            yield explain(pair, answer)


def explain(pair: Pair, answer: Prediction) -> Miss:
    """Look into one wrong answer that has a pose."""
    source, target = describe((pair.source_m, pair.target_m), ("auto", "auto"))
    T_reference, T_answer = (
        invert(target.T_given_own) @ T @ source.T_given_own
        for T in (pair.T_target_source, np.array(answer.T_target_source))
    )
    levels = [(source.coarse, target.coarse), (source.skipmap, target.skipmap)]
    T_aligned = refine(T_reference[None], levels).T_target_source[0]
    inliers, correspondences = count_inliers(source, target, T_reference)
    return Miss(
        pair=pair,
        overlap=measured_overlap(pair, source.skipmap.voxel_size_m),
        answer=answer,
        inliers=inliers,
        correspondences=correspondences,
        score=judge_closely(np.stack([T_aligned, T_answer]), source, target),
    )


def judge_closely(T_target_source: FloatArray, source: Scan, target: Scan) -> Score:
    """What a registration's last judgement would say of (C, 4, 4) poses that come close."""
    config = RegistrationConfig()
    evidence_s, evidence_t = (
        scan.valued_evidence(config.feature_weight) for scan in (source, target)
    )
    judge = Judge(evidence_s, evidence_t, config.final_samples, config.violation_weight)
    return judge.closer(T_target_source, judge.score(T_target_source))


def count_inliers(source: Scan, target: Scan, T_target_source: FloatArray) -> tuple[int, int]:
    """Right ones among the descriptor's correspondences under a (4, 4) pose, and all of them."""
    rows_s, rows_t, _ = correspond(source.skipmap, target.skipmap, source.network)
    moved_m = transform_points(T_target_source, source.skipmap.centroids_m[rows_s])
    apart_m = np.linalg.norm(moved_m - target.skipmap.centroids_m[rows_t], axis=1)
    return int((apart_m < INLIER_VOXELS * source.skipmap.voxel_size_m).sum()), len(rows_s)
