"""A run in TensorBoard: every method a run of its own, so that one chart holds them all."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skipnet.benchmark.reporting.comparison import confidence_scores
from skipnet.benchmark.reporting.pages import Dots
from skipnet.benchmark.reporting.tables import final_rows
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.viz.dashboard import (
    log_dots,
    log_hyperparameters,
    log_png,
    log_scalars,
    open_dashboard,
)
from skipnet.viz.tables import Table

CURVE_MM = tuple(round(10 ** (exponent / 8)) for exponent in range(8, 33))
"""Errors, 10 mm to 10 m, at which the cumulative curve is drawn."""
MEDIANS = {
    "mean_error_mm": "2 median error (mm)",
    "rotation_error_deg": "3 median rotation error (deg)",
    "time_s": "4 median time of the stage (s)",
}
"""Measures by the names under which TensorBoard sorts them."""
PAIR_MEASURES = ("mean_error_mm", "rotation_error_deg", "total_s")


def write_events(
    about: Mapping[str, str],
    settings: Mapping[str, Any],
    rows: Sequence[ScoreRow],
    entries: Sequence[Mapping[str, Any]],
    tables: Sequence[Table],
    pictures: Mapping[str, bytes],
    dots: Mapping[str, Dots],
    folder: Path,
) -> None:
    """Tables and pictures into ``folder``, the curves of each method into a folder within it.

    Args:
        about: what was run, by name.
        settings: all options of the run; those under ``methods`` belong to one method each.
        rows: of all methods.
        entries: of the summary, one per method and stage.
        tables: of the report.
        pictures: PNG contents by name.
        dots: what the mesh tab shows, by name.
        folder: what TensorBoard is pointed at, or a folder above it to compare runs. Emptied first:
            an earlier scoring of the same answers would mix with this one.
    """
    if folder.exists():
        shutil.rmtree(folder)
    with open_dashboard(folder) as writer:
        for place, table in enumerate(tables, start=1):
            writer.add_text(f"{place:02d} {table.title}", table.markdown())
        for name, png in pictures.items():
            log_png(writer, f"figures/{name}", png)
        for name, shown in dots.items():
            log_dots(writer, f"pairs/{name}", shown.points_m, shown.colours)
    step_of = {name: step for step, name in enumerate(dict.fromkeys(row.pair for row in rows))}
    for method in dict.fromkeys(row.method for row in rows):
        final = final_rows(rows, method)
        with open_dashboard(folder / re.sub(r"\W+", "_", method)) as writer:
            parameters = {**about, **_settings_of(method, settings), "method": method}
            log_hyperparameters(writer, parameters, method_scores(method, entries, final))
            for limit_mm, share in cumulative_curve(final):
                log_scalars(writer, {"2 curves/share of pairs within step mm": share}, limit_mm)
            for row in final:
                finite = {m: getattr(row, m) for m in PAIR_MEASURES}
                values = {f"3 pairs/{m}": v for m, v in finite.items() if math.isfinite(v)}
                log_scalars(writer, values, step_of[row.pair])


def _settings_of(method: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a run, of the methods those of one."""
    common = {name: value for name, value in settings.items() if name != "methods"}
    return {**common, "method_options": settings.get("methods", {}).get(method, {})}


def method_scores(
    method: str, entries: Sequence[Mapping[str, Any]], final: Sequence[ScoreRow]
) -> dict[str, float]:
    """The figures by which methods and runs are compared; those that are infinite are left out."""
    scores = {}
    for entry in entries:
        if entry["method"] == method:
            group = "1 result" if entry["stage"] == "fine" else "4 coarse"
            scores[f"{group}/1 success rate"] = entry["success_rate"]
            for measure, name in MEDIANS.items():
                if entry["median"][measure] is not None:
                    scores[f"{group}/{name}"] = entry["median"][measure]
    confidence = confidence_scores(final)
    if confidence is not None:
        scores["1 result/5 expected calibration error"] = confidence["ece"]
    return scores


def cumulative_curve(final: Sequence[ScoreRow]) -> list[tuple[int, float]]:
    """For each of ``CURVE_MM`` the share of the pairs whose mean axis error is at most that."""
    errors_mm = [row.mean_error_mm for row in final]
    return [
        (limit_mm, sum(error <= limit_mm for error in errors_mm) / len(errors_mm))
        for limit_mm in CURVE_MM
    ]
