"""One table of a sweep: what each of its runs came to, by what was varied."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skipnet.storage import append_line, plain, read_lines, write_text
from skipnet.viz.tables import Table, number

_RUNS_FILE, _TABLE_FILE = "runs.jsonl", "sweep.md"
Rows = Sequence[Mapping[str, Any]]
"""Of one run: name to word or number."""


def note_run(folder: Path, varied: Sequence[str], rows: Rows) -> None:
    """Add what a run came to; runs in other processes add to the same file.

    Args:
        folder: of the run, numbered, inside that of the sweep.
        varied: the overrides that this run has.
        rows: what it came to.
    """
    entry = {"run": folder.name, "varied": list(varied), "rows": plain(list(rows))}
    append_line(folder.parent / _RUNS_FILE, entry)


def sweep_table(folder: Path) -> str:
    """Write the table of all runs of a sweep; its text.

    Options that no two runs have differently are left out.
    """
    entries = [json.loads(line) for line in read_lines(folder / _RUNS_FILE)]
    latest = {entry["run"]: entry for entry in entries}
    runs = [latest[name] for name in sorted(latest, key=lambda name: (len(name), name))]
    options = [dict(word.partition("=")[::2] for word in run["varied"]) for run in runs]
    names = dict.fromkeys(name for one in options for name in one)
    differing = [name for name in names if len({one.get(name) for one in options}) > 1]
    measures = list(dict.fromkeys(name for run in runs for row in run["rows"] for name in row))
    rows = [
        (run["run"], *(one.get(name, "") for name in differing), *(_word(row, m) for m in measures))
        for run, one in zip(runs, options, strict=True)
        for row in run["rows"]
    ]
    text = Table("Sweep", ("run", *differing, *measures), tuple(rows)).markdown()
    write_text(folder / _TABLE_FILE, text)
    return text


def _word(row: Mapping[str, Any], measure: str) -> str:
    value = row.get(measure)
    return value if isinstance(value, str) else number(value)
