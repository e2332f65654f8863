"""Predictions against the truth: one row per pair, method and stage, and what the rows come to."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.options import ProtocolKind
from skipnet.benchmark.scoring.predictions import Prediction, load_correspondences
from skipnet.benchmark.scoring.protocols import right_by_rule
from skipnet.metrics.poses import inlier_ratio, measured_overlap, score_pose
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.storage import replacing
from skipnet.types import Pair


@dataclass(frozen=True)
class ScoreRow:
    """One line of scores.csv; errors are inf where the method gave no pose."""

    pair: str
    set: str
    method: str
    stage: str
    """coarse, or fine: the final pose."""
    counts: bool
    """Whether the pair is in the denominator under the run's protocol."""
    success: bool
    """By the run's protocol."""
    rotation_error_deg: float
    translation_error_mm: float
    x_error_mm: float
    y_error_mm: float
    z_error_mm: float
    mean_error_mm: float
    time_s: float
    """Of this stage alone: map and transform for coarse, fine alignment for fine; all of them for
    a method with one stage."""
    map_s: float
    transform_s: float
    total_s: float
    """Of all the method's stages."""
    status: str
    confidence: float | None
    margin: float | None
    """By what share of its own score the pose beats its best rival."""
    overlap: float | None
    source_points: int
    target_points: int
    rmse_mm: float | None
    """Through gt.info; None where the pair has none."""
    inlier_ratio: float | None
    """Of the method's correspondences; None if it has none."""
    own_limits: str
    """The pair's own thresholds, in words."""
    error: str
    right_by: dict[str, bool] = field(default_factory=dict)
    """Rule to whether the pose is right by it; each is a column of its own in the file."""


@dataclass(frozen=True)
class Scorer:
    """The rules of a run, and where its predictions lie."""

    protocol: ProtocolKind
    folder: Path
    """Where the files that predictions name are."""
    inlier_distance_m: float | None = None
    """Correspondences closer than this are inliers; None: two voxels of the pair's own size."""

    def score(self, pair: Pair, prediction: Prediction, stage: str, scene: Scene) -> ScoreRow:
        """One line of scores.csv."""
        score = score_pose(prediction.pose(stage), pair)
        right_by = right_by_rule(score, pair)
        x_mm, y_mm, z_mm = (1e3 * error_m for error_m in score.axis_errors_m)
        map_s, transform_s = (prediction.stage_s.get(name, 0.0) for name in ("map", "transform"))
        fine_s = prediction.stage_s.get("fine", 0.0)
        total_s = prediction.time_s if prediction.error else map_s + transform_s + fine_s
        if stage == "coarse":
            stage_s = map_s + transform_s
        else:
            stage_s = total_s if prediction.T_target_source_coarse is None else fine_s
        return ScoreRow(
            pair=pair.name,
            set=pair.set_name,
            method=prediction.method,
            stage=stage,
            counts=self.protocol.name in right_by,
            success=right_by.get(self.protocol.name, False),
            rotation_error_deg=float(np.rad2deg(score.rotation_error_rad)),
            translation_error_mm=1e3 * score.translation_error_m,
            x_error_mm=x_mm,
            y_error_mm=y_mm,
            z_error_mm=z_mm,
            mean_error_mm=1e3 * score.mean_error_m,
            # A call that broke has no stages; all of it was spent on the pair.
            time_s=total_s if prediction.error else stage_s,
            map_s=map_s,
            transform_s=transform_s,
            total_s=total_s,
            status=prediction.status,
            confidence=prediction.confidence,
            margin=prediction.margin,
            overlap=scene.overlap,
            source_points=len(pair.source_m),
            target_points=len(pair.target_m),
            rmse_mm=None if score.rmse_m is None else 1e3 * score.rmse_m,
            inlier_ratio=self._inlier_ratio(pair, prediction, scene),
            own_limits=scene.own_limits,
            error=prediction.error or "",
            right_by=right_by,
        )

    def _inlier_ratio(self, pair: Pair, prediction: Prediction, scene: Scene) -> float | None:
        found = load_correspondences(self.folder, prediction)
        if found is None:
            return None
        distance_m = self.inlier_distance_m or 2 * scene.voxel_size_m
        return inlier_ratio(*found, pair.T_target_source, distance_m)


@dataclass(frozen=True)
class Scene:
    """What the scorer knows of a pair, whoever answered it."""

    voxel_size_m: float
    overlap: float
    """As the data set gives it, otherwise measured by the truth."""
    own_limits: str

    @classmethod
    def of(cls, pair: Pair) -> Scene:
        """Measure one pair."""
        size_m = choose_voxel_size(pair.source_m, pair.target_m)
        overlap = measured_overlap(pair, size_m) if pair.overlap is None else pair.overlap
        limit_deg = float(np.rad2deg(pair.success_rotation_rad))
        return cls(size_m, overlap, f"{limit_deg:g}°, {pair.success_translation_m:g} m")


def score_predictions(
    pair_set: PairSet, methods: Sequence[str], predictions: Sequence[Prediction], scorer: Scorer
) -> list[ScoreRow]:
    """One row per pair, method and stage that the method has, in the order of the pairs.

    Raises:
        ValueError: if a method has no prediction for a pair, as rates over fewer pairs would
            flatter it; or if the protocol applies to none of the pairs.
    """
    of = {(prediction.pair, prediction.method): prediction for prediction in predictions}
    missing = [(p, m) for p in pair_set.names for m in methods if (p, m) not in of]
    if missing:
        raise ValueError(f"{len(missing)} predictions are missing, the first is {missing[0]}")
    two_staged = {p.method for p in predictions if p.T_target_source_coarse is not None}
    rows = []
    for pair in pair_set:
        scene = Scene.of(pair)
        for method in methods:
            stages = ("coarse", "fine") if method in two_staged else ("fine",)
            rows += [scorer.score(pair, of[pair.name, method], stage, scene) for stage in stages]
    if not any(row.counts for row in rows):
        raise ValueError(
            f"protocol={scorer.protocol.name} applies to none of these pairs: it needs gt.info "
            f"and pairs that are not consecutive; choose another, such as protocol=deg15_30cm"
        )
    return rows


def choose_best(rows: Sequence[ScoreRow], group_of: dict[str, str]) -> dict[tuple[str, str], str]:
    """For each group and set the most successful method; ties go to the smaller median error.

    It is chosen with the truth in hand, so it flatters.

    Args:
        rows: of all methods.
        group_of: method to its group, for those that have one.
    """
    chosen = {}
    for group in dict.fromkeys(group_of.values()):
        members = [method for method in group_of if group_of[method] == group]
        for name in dict.fromkeys(row.set for row in rows):
            of = {v: [r for r in rows if (r.method, r.set) == (v, name)] for v in members}
            chosen[group, name] = max(members, key=lambda method: _merit(of[method]))
    return chosen


def best_of_groups(rows: Sequence[ScoreRow], chosen: dict[tuple[str, str], str]) -> list[ScoreRow]:
    """The rows of the chosen methods once more, with their group as the method."""
    return [
        replace(row, method=group)
        for (group, name), method in chosen.items()
        for row in rows
        if (row.method, row.set) == (method, name)
    ]


def _merit(rows: list[ScoreRow]) -> tuple[int, float]:
    final = [row for row in rows if row.stage == "fine"]
    return sum(row.success for row in final), -float(np.median([r.mean_error_mm for r in final]))


def write_scores(rows: Sequence[ScoreRow], path: Path) -> None:
    """All rows as CSV, units in the headers, one column for each rule (empty: does not count)."""
    names = [field.name for field in fields(ScoreRow) if field.name != "right_by"]
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*names, *(f"right_{kind.name}" for kind in ProtocolKind)])
        for row in rows:
            rules = [row.right_by.get(kind.name) for kind in ProtocolKind]
            writer.writerow([*(getattr(row, name) for name in names), *rules])
