"""What studies share: jobs that are done once and kept, and a report like the benchmark's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from skipnet.benchmark.reporting.pages import Report, ReportFigure, run_versions
from skipnet.networks.catalog import find_network
from skipnet.parallel.pools import mapping
from skipnet.progress import clear, say, tell
from skipnet.provenance import __version__
from skipnet.storage import append_line, parsed, plain, read_lines, write_config
from skipnet.studies.options import StudyConfig
from skipnet.viz.tables import Table

OUTCOMES_FILE = "outcomes.jsonl"
Job = TypeVar("Job")
Outcome = dict[str, Any]


def do_all(
    jobs: Mapping[str, Job],
    work: Callable[[Job], Mapping[str, Any]],
    folder: Path,
    workers: int = 1,
) -> list[Outcome]:
    """What ``work`` makes of every job, in order; jobs done earlier in the folder are not repeated.

    Args:
        jobs: by a name that says all that the outcome depends on.
        work: a function that another process can import; its result is kept as JSON.
        folder: takes the outcomes as they come, so that a killed study goes on where it stopped.
        workers: processes.

    Raises:
        ValueError: the folder has outcomes of another version of skipnet or its network.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, maker = folder / OUTCOMES_FILE, _maker()
    known = _read(path, maker)
    todo = [name for name in jobs if name not in known]
    if len(todo) < len(jobs):
        say(f"{len(jobs) - len(todo)} of {len(jobs)} were done before")
    with mapping(workers) as each:
        tell("jobs", 0, len(todo))
        outcomes = each(work, [jobs[name] for name in todo])
        for number, (name, outcome) in enumerate(zip(todo, outcomes, strict=True), start=1):
            known[name] = plain(outcome)
            append_line(path, {"job": name, "maker": maker, "outcome": known[name]})
            say(f"[{number}/{len(todo)}] {name}")
            tell("jobs", number, len(todo))
    return [known[name] for name in jobs]


def report(
    config: StudyConfig,
    title: str,
    about: Mapping[str, str],
    tables: Sequence[Table],
    figures: Sequence[ReportFigure] = (),
    sentences: Sequence[str] = (),
    **figures_of_summary: Any,
) -> dict[str, Any]:
    """Write config.yaml, summary.json, report.md and report.html, and print what it comes to.

    Args:
        config: of the study; names the folder.
        title: the question that it asks.
        about: what was run, name to description.
        tables: of the report.
        figures: beneath them.
        sentences: above them.
        **figures_of_summary: what else the summary holds.

    Returns:
        The content of summary.json.
    """
    folder = Path(config.output_dir)
    summary: dict[str, Any] = {
        "about": dict(about),
        "versions": run_versions(),
        "comparison": list(sentences),
        **plain(figures_of_summary),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_config(config, folder / "config.yaml")
    Report(title, summary, tables, figures).write(folder)
    clear()
    print("\n".join(table.markdown() for table in tables if not table.folded))
    print("\n".join([*sentences, f"see {folder / 'report.html'}"]))
    return summary


def _maker() -> str:
    """The version of all that answers depend on, in one word."""
    return f"{__version__}-{find_network().digest}"


def _read(path: Path, maker: str) -> dict[str, Outcome]:
    entries = [
        parsed(line, f"{path}, line {number}") for number, line in enumerate(read_lines(path), 1)
    ]
    for number, entry in enumerate(entries, start=1):
        if set(entry) != {"job", "maker", "outcome"} or not isinstance(entry["outcome"], dict):
            raise ValueError(f"{path}, line {number} is no outcome: choose another output_dir")
    others = {entry["maker"] for entry in entries} - {maker}
    if others:
        raise ValueError(
            f"{path} has outcomes of another version ({others.pop()}, this is {maker}): "
            f"choose another output_dir, or remove the file"
        )
    return {entry["job"]: entry["outcome"] for entry in entries}
