"""What the score rows of each method come to: rates, medians, quantiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.metrics.poses import INLIER_SHARE, success_rate, wilson_interval

MEASURES = (
    "rotation_error_deg",
    "translation_error_mm",
    "x_error_mm",
    "y_error_mm",
    "z_error_mm",
    "mean_error_mm",
    "time_s",
    "map_s",
    "transform_s",
    "total_s",
)
"""Columns of a score row that are averaged."""


def summarise(rows: Sequence[ScoreRow], labels: dict[str, str]) -> list[dict[str, Any]]:
    """One entry per method and stage, in order of appearance.

    Rates and quantiles are over all pairs that count, a missing pose counting as a failure with
    infinite errors (a quantile that is infinite is None). Means are over the pairs with a pose,
    ``poses`` of them; RRE and RTE are means over the successes, as it is usual.
    """
    rows = [row for row in rows if row.counts]
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
    entry["quantile_90"] = {
        name: _finite(quantile_90([getattr(row, name) for row in rows])) for name in MEASURES
    }
    right = [row for row in rows if row.success]
    entry["mean_of_successes"] = {
        name: _finite_mean([getattr(row, name) for row in right]) for name in MEASURES
    }
    margins = [row.margin for row in rows if row.margin is not None]
    entry["median_margin"] = _median(margins) if margins else None
    entry |= _correspondence_scores(rows)
    entry["mean"] = {name: _finite_mean([getattr(row, name) for row in rows]) for name in MEASURES}
    entry["largest"] = {name: _finite(max(getattr(row, name) for row in rows)) for name in MEASURES}
    return entry


def _correspondence_scores(rows: list[ScoreRow]) -> dict[str, float | None]:
    """Mean inlier ratio and feature-matching recall; None for a method without correspondences.

    Where a method with correspondences broke it has no inliers.
    """
    if all(row.inlier_ratio is None for row in rows):
        return {"mean_inlier_ratio": None, "feature_matching_recall": None}
    ratios = np.array([row.inlier_ratio or 0.0 for row in rows])
    recall = (ratios > INLIER_SHARE).mean()
    return {"mean_inlier_ratio": float(ratios.mean()), "feature_matching_recall": float(recall)}


def quantile_90(values: list[float]) -> float:
    """The smallest value that at least 90 % do not exceed; infinite if too many are.

    >>> quantile_90([float("inf"), *range(1, 10)])
    9.0
    """
    return float(np.quantile(values, 0.9, method="inverted_cdf"))


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
