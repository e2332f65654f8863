"""The headline: of what kinds of pairs how many are right, and what was called registered."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from skipnet.studies.study import OUTCOMES_FILE
from skipnet.studies.vigilance import POSITIVES

HEAD = "| | right | called registered | registered, but wrong |\n|---|---:|---:|---:|"
METHOD = "skipnet"
Answer = tuple[bool, bool]
"""Whether it is right, and whether it was called registered."""


def overview(folders: Mapping[str, Path]) -> str:
    """Markdown with a row for each kind of pairs that was measured; empty when none was.

    Args:
        folders: of the runs, by the names of their blocks.
    """
    rows = []
    for name, kind in (
        ("real", "real pairs: LiDAR, depth cameras, terrestrial scanners (development pairs)"),
        ("paper", "simulated rooms of the paper"),
        ("overlap", "simulated pairs of 5 to 60 % overlap"),
    ):
        if name in folders:
            rows.append(_row(kind, _of_benchmark(folders[name])))
    if "vigilance" in folders:
        groups = _of_vigilance(folders["vigilance"])
        rows.append(_row(f"simulated pairs of {len(POSITIVES)} kinds", groups[True]))
        rows.append(_row("pairs of different rooms", groups[False]))
    return "\n".join([HEAD, *rows]) if rows else ""


def _row(kind: str, answers: Iterable[Answer]) -> str:
    answers = list(answers)
    right = sum(is_right for is_right, _ in answers)
    registered = sum(said for _, said in answers)
    wrong = sum(said and not is_right for is_right, said in answers)
    return f"| {len(answers)} {kind} | {right} | {registered} | {wrong} |"


def _of_benchmark(folder: Path) -> list[Answer]:
    """Final answers of skipnet in a run of evaluate.py."""
    with (folder / "scores.csv").open(encoding="utf-8") as file:
        return [
            (row["success"] == "True", row["status"] == "registered")
            for row in csv.DictReader(file)
            if (row["method"], row["stage"]) == (METHOD, "fine")
        ]


def _of_vigilance(folder: Path) -> dict[bool, list[Answer]]:
    """Answers to pairs of one right answer (True) and to pairs that share nothing (False)."""
    groups: dict[bool, list[Answer]] = {True: [], False: []}
    for line in (folder / OUTCOMES_FILE).read_text(encoding="utf-8").splitlines():
        entry = json.loads(line)
        group, outcome = entry["job"].split(":")[0], entry["outcome"]
        answer = outcome["right"], outcome["status"] == "registered"
        if group in POSITIVES or group.startswith("negatives"):
            groups[group in POSITIVES].append(answer)
    return groups
