"""Predictions against the truth: one row per pair, method and stage, and what the rows come to."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets import PairSet
from skipnet.benchmark.metrics import score_pose, success_rate, wilson_interval
from skipnet.benchmark.predictions import Prediction
from skipnet.types import Pair


@dataclass(frozen=True)
class ScoreRow:
    """One line of scores.csv; errors are inf where the method gave no pose."""

    pair: str
    set: str
    method: str
    stage: str
    """coarse, or fine: the final pose."""
    success: bool
    rotation_error_deg: float
    translation_error_mm: float
    x_error_mm: float
    y_error_mm: float
    z_error_mm: float
    mean_error_mm: float
    time_s: float
    """Of this stage alone: map and transform for coarse, fine alignment for fine."""
    map_s: float
    transform_s: float
    status: str
    confidence: float | None
    lead: float | None
    """By what share of its own score the pose beats its best rival."""
    overlap: float | None
    source_points: int
    target_points: int
    error: str


MEASURES = (
    "rotation_error_deg",
    "x_error_mm",
    "y_error_mm",
    "z_error_mm",
    "mean_error_mm",
    "time_s",
    "map_s",
    "transform_s",
)


def score_predictions(
    pair_set: PairSet, methods: Sequence[str], predictions: Sequence[Prediction]
) -> list[ScoreRow]:
    """One row per pair, method and stage that the method has, in the order of the pairs.

    Raises:
        ValueError: if a method has no prediction for a pair; rates over fewer pairs would flatter
            it.
    """
    of = {(prediction.pair, prediction.method): prediction for prediction in predictions}
    missing = [(p, m) for p in pair_set.names for m in methods if (p, m) not in of]
    if missing:
        raise ValueError(f"{len(missing)} predictions are missing, the first is {missing[0]}")
    two_staged = {p.method for p in predictions if p.T_target_source_coarse is not None}
    rows = []
    for pair in pair_set:
        for method in methods:
            stages = ("coarse", "fine") if method in two_staged else ("fine",)
            rows += [_score(pair, of[pair.name, method], stage) for stage in stages]
    return rows


def _score(pair: Pair, prediction: Prediction, stage: str) -> ScoreRow:
    score = score_pose(prediction.pose(stage), pair)
    x_mm, y_mm, z_mm = (1e3 * error_m for error_m in score.axis_errors_m)
    map_s = prediction.stage_s.get("map", 0.0)
    transform_s = prediction.stage_s.get("transform", 0.0)
    fine_s = prediction.stage_s.get("fine", 0.0)
    stage_s = map_s + transform_s if stage == "coarse" else fine_s
    return ScoreRow(
        pair=pair.name,
        set=pair.set_name,
        method=prediction.method,
        stage=stage,
        success=score.success,
        rotation_error_deg=float(np.rad2deg(score.rotation_error_rad)),
        translation_error_mm=1e3 * score.translation_error_m,
        x_error_mm=x_mm,
        y_error_mm=y_mm,
        z_error_mm=z_mm,
        mean_error_mm=1e3 * score.mean_error_m,
        # A call that broke has no stages; all of it was spent on the pair.
        time_s=prediction.time_s if prediction.error else stage_s,
        map_s=map_s,
        transform_s=transform_s,
        status=prediction.status,
        confidence=prediction.confidence,
        lead=prediction.lead,
        overlap=pair.overlap,
        source_points=len(pair.source_m),
        target_points=len(pair.target_m),
        error=prediction.error or "",
    )


def write_scores(rows: Sequence[ScoreRow], path: Path) -> None:
    """All rows as CSV, units in the headers."""
    names = [field.name for field in fields(ScoreRow)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([getattr(row, name) for name in names] for row in rows)


def summarise(rows: Sequence[ScoreRow], labels: dict[str, str]) -> list[dict[str, Any]]:
    """One entry per method and stage, in order of appearance.

    Rates and medians are over all pairs, a missing pose counting as a failure with infinite errors
    (a median that is infinite is None). Means are over the pairs with a pose, ``poses`` of them.
    """
    keys = list(dict.fromkeys((row.method, row.stage) for row in rows))
    both = {method for method, stage in keys if stage == "coarse"}
    return [
        _summarise_one(
            [row for row in rows if (row.method, row.stage) == (method, stage)],
            row_label(labels[method], stage, method in both),
        )
        for method, stage in keys
    ]


def row_label(label: str, stage: str, has_coarse: bool) -> str:
    """Name of a row in a table.

    >>> row_label("skipnet", "fine", has_coarse=True)
    'skipnet: fine, after coarse'
    """
    if not has_coarse:
        return label
    return f"{label}: {'coarse' if stage == 'coarse' else 'fine, after coarse'}"


def _summarise_one(rows: list[ScoreRow], label: str) -> dict[str, Any]:
    successes = [row.success for row in rows]
    entry: dict[str, Any] = {
        "method": rows[0].method,
        "stage": rows[0].stage,
        "label": label,
        "pairs": len(rows),
        "poses": sum(math.isfinite(row.mean_error_mm) for row in rows),
        "successes": sum(successes),
        "success_rate": success_rate(successes),
        "success_interval_95": wilson_interval(sum(successes), len(rows)),
        "success_rate_by_set": _by_set(rows),
    }
    entry["success_rate_mean_of_sets"] = float(np.mean(list(entry["success_rate_by_set"].values())))
    entry["median"] = {name: _median([getattr(row, name) for row in rows]) for name in MEASURES}
    leads = [row.lead for row in rows if row.lead is not None]
    entry["median_lead"] = _median(leads) if leads else None
    entry["mean"] = {name: _finite_mean([getattr(row, name) for row in rows]) for name in MEASURES}
    entry["largest"] = {name: _finite(max(getattr(row, name) for row in rows)) for name in MEASURES}
    return entry


def _by_set(rows: list[ScoreRow]) -> dict[str, float]:
    return {
        name: success_rate([row.success for row in rows if row.set == name])
        for name in dict.fromkeys(row.set for row in rows)
    }


def _median(values: list[float]) -> float | None:
    return _finite(float(np.median(values)))


def _finite_mean(values: list[float]) -> float | None:
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else None


def _finite(value: float) -> float | None:
    """JSON has no infinity: None stands for it."""
    return float(value) if np.isfinite(value) else None
