"""What a run leaves for people: scores, summary, report.md and .html, figures, TensorBoard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.reporting.comparison import (
    chosen_table,
    confidence_table,
    correspondences_table,
    overlap_table,
    rules_table,
    sets_table,
    success_table,
)
from skipnet.benchmark.reporting.events import write_events
from skipnet.benchmark.reporting.figures import draw_extremes, draw_figures
from skipnet.benchmark.reporting.pages import Report, run_versions
from skipnet.benchmark.reporting.tables import (
    PAPER_TABLE_2,
    failures_table,
    means_table,
    pairs_table,
    stages_table,
    table_2,
    verdict_table,
)
from skipnet.benchmark.scoring.predictions import Prediction
from skipnet.benchmark.scoring.protocols import PROTOCOLS, Protocol
from skipnet.benchmark.scoring.scoring import Scorer, ScoreRow, write_scores
from skipnet.benchmark.scoring.summary import summarise
from skipnet.viz.tables import Table, number

PAPER_FAMILY = "paper_room"


@dataclass(frozen=True)
class Results:
    """All that a report is made of."""

    about: dict[str, str]
    """What was run: name to description; ``benchmark`` is among the names."""
    settings: dict[str, Any]
    """All options of the run."""
    rows: list[ScoreRow]
    predictions: list[Prediction]
    labels: dict[str, str]
    """Method to its name in tables, in the order of the run."""
    pair_set: PairSet
    scorer: Scorer
    chosen: dict[tuple[str, str], str]
    """Group and set to the method that was best there."""
    worst: int
    """Pairs to show before and after, the worst of the first method."""

    @property
    def rule(self) -> Protocol:
        """What counts as right."""
        return PROTOCOLS[self.scorer.protocol]


def write_report(results: Results, folder: Path) -> dict[str, Any]:
    """Write every file of a run but its config and predictions into ``folder``.

    Returns:
        The content of summary.json: what was run, with what, and one entry per method and stage.
    """
    entries = summarise(results.rows, results.labels)
    summary = {
        "about": results.about,
        "versions": run_versions(),
        "comparison": comparison(entries) if is_papers_room(results.rows) else [],
        "rows": entries,
    }
    write_scores(results.rows, folder / "scores.csv")
    tables = make_tables(results, entries)
    figures = draw_figures(results.rows, entries, results.labels)
    figures += draw_extremes(
        next(iter(results.labels)),
        results.rows,
        results.predictions,
        results.pair_set,
        results.worst,
    )
    title = f"Registration benchmark: {results.about['benchmark']}"
    pictures = Report(title, summary, tables, figures).write(folder)
    dots = {one.name: one.dots for one in figures if one.dots is not None}
    where = folder / "tensorboard"
    write_events(
        results.about, results.settings, results.rows, entries, tables, pictures, dots, where
    )
    return summary


def make_tables(results: Results, entries: Sequence[dict[str, Any]]) -> list[Table]:
    """The report's tables; for the paper's room the one in the form of its Table 2 first."""
    rows, labels, rule = results.rows, results.labels, results.rule
    several_sets = len(entries[0]["success_rate_by_set"]) > 1
    several_staged = sum(entry["stage"] == "coarse" for entry in entries) > 1
    tables = [
        table_2(entries, with_paper=True) if is_papers_room(rows) else None,
        success_table(entries, labels, rule),
        sets_table(rows, labels, rule) if several_sets else None,
        chosen_table(results.chosen, labels),
        rules_table(rows, labels),
        overlap_table(rows, labels),
        stages_table(entries, labels) if several_staged else None,
        correspondences_table(entries, labels, results.scorer.inlier_distance_m),
        verdict_table(rows, labels),
        confidence_table(rows, labels),
        means_table(entries),
        failures_table(rows, results.predictions),
        pairs_table(rows, labels),
    ]
    return [table for table in tables if table is not None]


def is_papers_room(rows: Sequence[ScoreRow]) -> bool:
    """Whether the pairs are those of the paper's experiment, so its figures may stand there."""
    return {row.set for row in rows} == {PAPER_FAMILY}


def comparison(entries: Sequence[dict[str, Any]]) -> list[str]:
    """Ratios between skipnet and ICP applied directly, as sentences; empty unless both ran."""
    of = {(entry["method"], entry["stage"]): entry["median"] for entry in entries}
    if not {("skipnet", "coarse"), ("skipnet", "fine"), ("icp", "fine")} <= set(of):
        return []
    coarse, fine, icp = (
        of[key] for key in (("skipnet", "coarse"), ("skipnet", "fine"), ("icp", "fine"))
    )
    if None in (coarse["time_s"], fine["time_s"], fine["mean_error_mm"], icp["mean_error_mm"]):
        return []
    times = icp["time_s"] / (coarse["time_s"] + fine["time_s"])
    errors = icp["mean_error_mm"] / fine["mean_error_mm"]
    paper_coarse, paper_fine, paper_icp = (
        PAPER_TABLE_2[key] for key in (("skipnet", "coarse"), ("skipnet", "fine"), ("icp", "fine"))
    )
    paper_times = paper_icp["time_s"] / (paper_coarse["time_s"] + paper_fine["time_s"])
    paper_errors = paper_icp["mean_error_mm"] / paper_fine["mean_error_mm"]
    return [
        f"ICP directly takes {number(times)} times as long as skipnet's coarse and fine match "
        f"together (in the paper {number(paper_times)} times).",
        f"Its median error is {number(errors)} times that of skipnet's fine match "
        f"(in the paper {number(paper_errors)} times).",
    ]
