"""The report's tables, as plain strings that Markdown, HTML and TensorBoard share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from skipnet.benchmark.scoring.predictions import Prediction
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.benchmark.scoring.summary import row_label
from skipnet.viz.tables import NOTHING, Table, number

STATUSES = ("registered", "ambiguous", "failed")


# Table 2 of the paper: what skipnet's rows stand beside.
PAPER_TABLE_2: dict[tuple[str, str], dict[str, float]] = {
    ("skipnet", "coarse"): {
        "time_s": 40.42898,
        "map_s": 40.343184,
        "transform_s": 0.085791,
        "x_error_mm": 52.767,
        "y_error_mm": 12.13,
        "z_error_mm": 63.72,
        "mean_error_mm": 42.872,
    },
    ("skipnet", "fine"): {
        "time_s": 8.501487,
        "x_error_mm": 8.943,
        "y_error_mm": 6.673,
        "z_error_mm": 10.31,
        "mean_error_mm": 8.642,
    },
    ("icp", "fine"): {
        "time_s": 665.682670,
        "x_error_mm": 1196.863,
        "y_error_mm": 104.67,
        "z_error_mm": 606.433,
        "mean_error_mm": 635.9887,
    },
}

TABLE_2_COLUMNS = {
    "time_s": "time (s)",
    "map_s": "of it map (s)",
    "transform_s": "transform (s)",
    "x_error_mm": "X (mm)",
    "y_error_mm": "Y (mm)",
    "z_error_mm": "Z (mm)",
    "mean_error_mm": "mean (mm)",
    "rotation_error_deg": "rotation (deg)",
}


def table_2(summary: Sequence[dict[str, Any]], with_paper: bool) -> Table:
    """The paper's Table 2 over all pairs: medians, with the paper's own line under each of ours."""
    rows = []
    for entry in summary:
        rows.append((entry["label"], _success(entry), *_measures(entry, entry["median"])))
        paper = PAPER_TABLE_2.get((entry["method"], entry["stage"]))
        if with_paper and paper is not None:
            rows.append(("in the paper", "1 pair", *_measures(entry, paper)))
    note = (
        "Medians over all pairs, column by column; a pair without an answer has infinite errors. "
        "X, Y, Z: mean over the source's points p of |T_estimated p - T_true p| along that axis of "
        "the target's frame; mean: of the three. The time of a row is that of its own stage: fine "
        "comes on top of coarse."
    )
    headers = ("", "success", *TABLE_2_COLUMNS.values())
    return Table(
        "Time and error of each stage, as in Table 2 of the paper", headers, tuple(rows), note
    )


def means_table(summary: Sequence[dict[str, Any]]) -> Table:
    """The same columns as means, which one bad pair can rule, with the largest mean error."""
    rows = tuple(
        (
            entry["label"],
            f"{entry['poses']} of {entry['pairs']}",
            *_measures(entry, entry["mean"]),
            number(entry["largest"]["mean_error_mm"]),
        )
        for entry in summary
    )
    headers = ("", "poses", *TABLE_2_COLUMNS.values(), "largest (mm)")
    note = "Means over the pairs with a pose; largest: the worst pair (– if one has no pose)."
    return Table("Means instead of medians", headers, rows, note, folded=True)


def stages_table(summary: Sequence[dict[str, Any]], labels: dict[str, str]) -> Table:
    """Methods with a coarse stage side by side, one line each: what ablations are read from."""
    of = {(entry["method"], entry["stage"]): entry for entry in summary}
    rows = []
    for method in dict.fromkeys(entry["method"] for entry in summary if entry["stage"] == "coarse"):
        coarse, fine = of[method, "coarse"], of[method, "fine"]
        cells = [labels[method]]
        for entry in (coarse, fine):
            median = entry["median"]
            errors = (median["mean_error_mm"], median["rotation_error_deg"], median["time_s"])
            cells += [_success(entry), *(number(value) for value in errors)]
        rows.append((*cells, number(fine["median_margin"])))
    measures = ("success", "mean (mm)", "rotation (deg)", "time (s)")
    staged = (f"{stage} {name}" for stage in ("coarse", "fine") for name in measures)
    headers = ("", *staged, "margin")
    note = (
        "Errors and times are medians over all pairs. Both stages are held to the same thresholds. "
        "Margin: by what share of its own score the pose beats its best rival."
    )
    return Table("Coarse and fine side by side", headers, tuple(rows), note)


def verdict_table(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Table:
    """What each method said about its answers against whether they were right."""
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        final = final_rows(rows, method)
        cells = []
        for status in STATUSES:
            said = [row for row in final if row.status == status and not row.error]
            cells.append(right_of(said))
        lines.append((labels[method], *cells, str(sum(bool(row.error) for row in final))))
    note = (
        "Right answers among those with that status. "
        "A method without a verdict of its own says registered."
    )
    return Table("What the methods said", ("", *STATUSES, "no answer"), tuple(lines), note)


def failures_table(rows: Sequence[ScoreRow], predictions: Sequence[Prediction]) -> Table | None:
    """Every final pose that was not a success, method by method, worst first, and why; None if all
    were right."""
    reason_of = {(p.pair, p.method): p.error or p.reason for p in predictions}
    failed = [row for row in rows if row.stage == "fine" and row.counts and not row.success]
    if not failed:
        return None
    place = {method: index for index, method in enumerate(dict.fromkeys(r.method for r in rows))}
    failed.sort(key=lambda row: (place[row.method], -row.mean_error_mm, row.pair))
    lines = tuple(
        (
            row.pair,
            row.method,
            row.status,
            number(row.rotation_error_deg),
            number(row.mean_error_mm),
            reason_of.get((row.pair, row.method), ""),
        )
        for row in failed
    )
    headers = ("pair", "method", "status", "rotation (deg)", "mean (mm)", "reason")
    return Table(f"Failures ({len(failed)})", headers, lines, folded=True)


def pairs_table(rows: Sequence[ScoreRow], labels: dict[str, str]) -> Table:
    """Every row of scores.csv that people look at."""
    both = {row.method for row in rows if row.stage == "coarse"}
    lines = tuple(
        (
            row.pair,
            row_label(labels[row.method], row.stage, row.method in both),
            "yes" if row.success else "no",
            number(row.time_s),
            number(row.x_error_mm),
            number(row.y_error_mm),
            number(row.z_error_mm),
            number(row.mean_error_mm),
            number(row.rotation_error_deg),
        )
        for row in rows
    )
    columns = [
        TABLE_2_COLUMNS[name] for name in ("time_s", "x_error_mm", "y_error_mm", "z_error_mm")
    ]
    headers = ("pair", "", "success", *columns, "mean (mm)", "rotation (deg)")
    return Table("Every pair", headers, lines, folded=True)


def final_rows(rows: Sequence[ScoreRow], method: str) -> list[ScoreRow]:
    """The method's final poses on the pairs that count."""
    return [row for row in rows if (row.method, row.stage) == (method, "fine") and row.counts]


def _measures(entry: dict[str, Any], values: Mapping[str, float | None]) -> list[str]:
    """The cells of Table 2; only the coarse stage has a map and a transform."""
    skipped = () if entry["stage"] == "coarse" else ("map_s", "transform_s")
    return [NOTHING if name in skipped else number(values.get(name)) for name in TABLE_2_COLUMNS]


def _success(entry: dict[str, Any]) -> str:
    return f"{entry['successes']} of {entry['pairs']}"


def right_of(rows: list[ScoreRow]) -> str:
    """How many of the rows are right; a dash for none at all."""
    return f"{sum(row.success for row in rows)} of {len(rows)}" if rows else NOTHING
