"""Tables that set methods side by side: success, rules, sets, overlap, matches, confidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from skipnet.benchmark.reporting.tables import final_rows, right_of
from skipnet.benchmark.scoring.protocols import PROTOCOLS, Protocol
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.metrics.calibration import expected_calibration_error
from skipnet.metrics.poses import success_rate, wilson_interval
from skipnet.types import FloatArray
from skipnet.viz.tables import Table, number

OVERLAP_EDGES = (0.0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 0.8, 1.0)


def success_table(
    summary: Sequence[dict[str, Any]], labels: dict[str, str], rule: Protocol
) -> Table:
    """One line per method: how often it is right, how exact, how fast."""
    lines = []
    for entry in summary:
        if entry["stage"] != "fine":
            continue
        low, high = entry["success_interval_95"]
        right, median, worst = (
            entry[name] for name in ("mean_of_successes", "median", "quantile_90")
        )
        errors = (
            right["rotation_error_deg"],
            right["translation_error_mm"],
            median["rotation_error_deg"],
            median["translation_error_mm"],
            worst["rotation_error_deg"],
            worst["translation_error_mm"],
            median["total_s"],
        )
        lines.append(
            (
                labels[entry["method"]],
                f"{headline_rate(entry, rule):.1%}",
                f"{entry['successes']} of {entry['pairs']}",
                f"{low:.0%} to {high:.0%}",
                *(number(value) for value in errors),
            )
        )
    rate = "mean of sets" if rule.mean_of_sets else "rate"
    headers = (
        *("", f"{rule.label}: {rate}", "pairs", "95 %", "RRE (deg)", "RTE (mm)"),
        *("median (deg)", "median (mm)", "90 % (deg)", "90 % (mm)", "time (s)"),
    )
    note = (
        f"{rule.sentence} RRE and RTE: means over the method's own successes. Median and 90 %: "
        "quantiles over all pairs, a pair without an answer counting as infinite (–). 95 %: Wilson "
        "interval of the pairs. Time: median of the whole call."
    )
    return Table("Success, error and time", headers, tuple(lines), note)


def headline_rate(entry: dict[str, Any], rule: Protocol) -> float:
    """The rate that the protocol asks for."""
    name = "success_rate_mean_of_sets" if rule.mean_of_sets else "success_rate"
    rate: float = entry[name]
    return rate


def rules_table(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Table:
    """The same answers under every published rule that applies, each in a column of its own."""
    final = [row for row in rows if row.stage == "fine"]
    rules = {k: p for k, p in PROTOCOLS.items() if any(k.name in row.right_by for row in final)}
    lines = []
    for method in dict.fromkeys(row.method for row in final):
        cells = []
        for kind, rule in rules.items():
            right: dict[str, list[bool]] = {}
            for row in final:
                if row.method == method and kind.name in row.right_by:
                    right.setdefault(row.set, []).append(row.right_by[kind.name])
            flags = [flag for of_set in right.values() for flag in of_set]
            rates = [success_rate(of_set) for of_set in right.values()]
            rate = float(np.mean(rates)) if rule.mean_of_sets else success_rate(flags)
            cells.append(f"{rate:.1%} ({sum(flags)} of {len(flags)})")
        lines.append((labels[method], *cells))
    headers = ("", *(rule.label for rule in rules.values()))
    sentences = " ".join(
        f"{rule.label}: {rule.sentence.removeprefix('Right: ')}"
        for rule in rules.values()
        if rule.rmse_m is not None or rule.rotation_deg is None
    )
    return Table("The same answers by each rule", headers, tuple(lines), sentences)


def sets_table(rows: Sequence[ScoreRow], labels: dict[str, str], rule: Protocol) -> Table:
    """Success per set, and the mean over sets, which does not let the largest set decide."""
    of_set = {row.set: row.own_limits for row in rows if row.counts}
    own = rule.rmse_m is None and rule.rotation_deg is None
    titles = [f"{name} ({limits})" if own else name for name, limits in of_set.items()]
    columns = []
    for method in dict.fromkeys(row.method for row in rows):
        final = final_rows(rows, method)
        parts = [[row for row in final if row.set == name] for name in of_set]
        mean = np.mean([success_rate([row.success for row in part]) for part in parts])
        columns.append([*map(right_of, parts), right_of(final), f"{mean:.1%}"])
    lines = zip([*titles, "all pairs", "mean of sets"], *columns, strict=True)
    return Table("Success by set", _heads(rows, labels), tuple(lines), rule.sentence)


def _heads(rows: Sequence[ScoreRow], labels: dict[str, str]) -> tuple[str, ...]:
    """Above a table with a column for each method."""
    return ("", *(labels[method] for method in dict.fromkeys(row.method for row in rows)))


def chosen_table(chosen: dict[tuple[str, str], str], labels: dict[str, str]) -> Table | None:
    """Which method stands for its group on each set; None without groups."""
    if not chosen:
        return None
    groups, sets = (list(dict.fromkeys(names)) for names in zip(*chosen, strict=True))
    lines = tuple((name, *(labels[chosen[group, name]] for group in groups)) for name in sets)
    note = "The method with most successes on the set; chosen with the truth in hand, it flatters."
    return Table("Best method of each set", ("", *groups), lines, note)


def overlap_table(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Table:
    """Success by the share of the source that the target sees too."""
    bins = list(zip(OVERLAP_EDGES, OVERLAP_EDGES[1:], strict=False))
    used = [one for one in bins if any(in_bin(row, one) for row in rows if row.counts)]
    final = [final_rows(rows, method) for method in dict.fromkeys(row.method for row in rows)]
    lines = tuple(
        (
            f"{one[0]:.0%} to {one[1]:.0%}",
            *(right_of([row for row in of_method if in_bin(row, one)]) for of_method in final),
        )
        for one in used
    )
    note = "Overlap as the data set gives it; otherwise the share of the source's voxels that lie "
    note += "within one voxel of the target under the true pose."
    return Table("Success by overlap", _heads(rows, labels), lines, note)


def in_bin(row: ScoreRow, limits: tuple[float, float]) -> bool:
    """Whether the pair's overlap is in [low, high), or at the very top."""
    low, high = limits
    if row.overlap is None:
        return False
    return low <= row.overlap < high or (high == OVERLAP_EDGES[-1] and row.overlap >= high)


def correspondences_table(
    summary: Sequence[dict[str, Any]], labels: dict[str, str], inlier_distance_m: float | None
) -> Table | None:
    """Inlier ratio and feature-matching recall; None if no method offers correspondences."""
    lines = tuple(
        (
            labels[entry["method"]],
            f"{entry['mean_inlier_ratio']:.3f}",
            f"{entry['feature_matching_recall']:.1%}",
        )
        for entry in summary
        if entry["stage"] == "fine" and entry["mean_inlier_ratio"] is not None
    )
    if not lines:
        return None
    distance = "two voxels" if inlier_distance_m is None else f"{inlier_distance_m:g} m"
    note = f"Inlier: the two points lie within {distance} of each other under the true pose. "
    note += "Recall: share of the pairs with more than 5 % inliers."
    headers = ("", "mean inlier ratio", "feature-matching recall")
    return Table("Correspondences", headers, lines, note)


def confidence_table(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Table | None:
    """How far the methods' confidence can be trusted; None if no method has one."""
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        scores = confidence_scores(final_rows(rows, method))
        if scores is not None:
            share = [f"{scores[name]:.1%}" for name in ("precision_90", "recall_90")]
            precision = number(scores["average_precision"])
            lines.append((labels[method], f"{scores['ece']:.3f}", precision, *share))
    if not lines:
        return None
    headers = ("", "ECE", "average precision", "precision at 0.9", "recall at 0.9")
    note = (
        "ECE: expected calibration error, ten bins. Precision at 0.9: share of right answers among "
        "those with a confidence of at least 0.9; recall: their share among all right answers."
    )
    return Table("Confidence", headers, tuple(lines), note)


def confidence_scores(final: Sequence[ScoreRow]) -> dict[str, float] | None:
    """ECE, average precision, precision and recall at 0.9; None where nothing was said or right."""
    from sklearn.metrics import average_precision_score

    confidence, right = confidences(final)
    if len(confidence) == 0 or not right.any():
        return None
    sure = confidence >= 0.9
    return {
        "ece": expected_calibration_error(confidence, right),
        "average_precision": float(average_precision_score(right, confidence)),
        "precision_90": float(right[sure].mean()) if sure.any() else 0.0,
        "recall_90": float(right[sure].sum() / right.sum()),
    }


def confidences(final: Sequence[ScoreRow]) -> tuple[FloatArray, FloatArray]:
    """(K,) confidences of the answers that have one, and (K,) whether they are right, 0 or 1."""
    said = [(row.confidence, row.success) for row in final if row.confidence is not None]
    pairs = np.array(said, dtype=np.float64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def overlap_curve(final: Sequence[ScoreRow]) -> list[tuple[float, float, float, float]]:
    """Middle of the bin, success rate, and its 95 % interval, for each bin that has pairs."""
    points = []
    for limits in zip(OVERLAP_EDGES, OVERLAP_EDGES[1:], strict=False):
        flags = [row.success for row in final if in_bin(row, limits)]
        if flags:
            interval = wilson_interval(sum(flags), len(flags))
            points.append((sum(limits) / 2, success_rate(flags), *interval))
    return points
