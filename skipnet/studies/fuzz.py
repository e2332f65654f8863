"""Files made worse at random, read in a process of their own: ``skipnet study fuzz``.

A file is read, or refused with one line that names it. All else is a finding: a crash, a reader
that does not come back, memory beyond reason, another error, points that are no numbers, words on
the terminal.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from skipnet.checks import check_known
from skipnet.clouds.formats.reading import SUPPORTED, read_cloud
from skipnet.parallel.pools import end_with_parent
from skipnet.studies.corpus import corpus
from skipnet.studies.mutations import mutated
from skipnet.studies.options import FuzzConfig
from skipnet.studies.study import do_all, report
from skipnet.viz.tables import Table

SLOW = (".las", ".laz", ".e57", ".obj", ".stl", ".glb", ".off")
"""Formats that libraries read, a fifth as many."""
IN_ONE_GO = 20_000
"""Files that one process reads: its start takes as long as thousands of small ones."""
LIMIT_S = 20.0
MOST_POINTS = 200_000
"""Of a mesh's samples; no other file here has more than some hundred."""
MOST_MEMORY_BYTES = 300 << 20
"""That a file of some kilobytes may take beyond what reading takes anyhow."""
LONGEST_LINE = 500
_INTRINSICS = '{"fx": 5, "fy": 5, "cx": 3, "cy": 2}'


@dataclass(frozen=True)
class Job:
    """Files of one format, by their numbers."""

    extension: str
    seed: int
    first: int
    last: int
    make: Callable[[list[bytes], str, int, int], bytes] = mutated
    """Makes the file of a number."""


def run(config: FuzzConfig) -> dict[str, Any]:
    """Read them all and report; the summary comes back."""
    for name in config.formats:
        check_known("formats", name, tuple(one[1:] for one in SUPPORTED))
    wanted = [one for one in SUPPORTED if not config.formats or one[1:] in config.formats]
    jobs = {
        f"{extension[1:]}/{config.seed}/{first}-{last}": Job(extension, config.seed, first, last)
        for extension in wanted
        for count in [config.files // 5 if extension in SLOW else config.files]
        for first in range(0, count, IN_ONE_GO)
        for last in [min(first + IN_ONE_GO, count)]
    }
    outcomes = do_all(jobs, do, Path(config.output_dir), config.workers)
    by_format = {
        extension: [
            outcome
            for outcome, job in zip(outcomes, jobs.values(), strict=True)
            if job.extension == extension
        ]
        for extension in wanted
    }
    found = [dict(finding) for outcome in outcomes for finding in outcome["findings"]]
    about = "changed at random from files that other libraries wrote"
    rows = tuple(_row(extension, of) for extension, of in by_format.items())
    return report(
        config,
        "Damaged files: is each read, or refused in one line?",
        {"files": about, "seed": str(config.seed)},
        [
            Table("Files", ("format", "files", "read", "refused", "findings", "s"), rows),
            Table("Findings", ("file", "kind", "told"), tuple(map(_told, found))),
        ],
        findings=found,
    )


def _row(extension: str, outcomes: list[dict[str, Any]]) -> tuple[str, ...]:
    sums = [sum(outcome[name] for outcome in outcomes) for name in ("read", "refused")]
    findings = sum(len(outcome["findings"]) for outcome in outcomes)
    time_s = sum(outcome["time_s"] for outcome in outcomes)
    return (extension, *(f"{n:,}" for n in (sum(sums) + findings, *sums, findings, round(time_s))))


def _told(finding: dict[str, Any]) -> tuple[str, str, str]:
    return finding["file"], finding["kind"], finding["told"]


def do(job: Job) -> dict[str, Any]:
    """Read a job's files in a child; one that dies or hangs is replaced, and the file noted."""
    started = time.perf_counter()
    counts = {"read": 0, "refused": 0}
    findings: list[dict[str, str]] = []
    number = job.first
    while number < job.last:
        number = _until_it_ends(job, number, counts, findings)
    return {**counts, "findings": findings, "time_s": time.perf_counter() - started}


def _until_it_ends(
    job: Job, number: int, counts: dict[str, int], findings: list[dict[str, str]]
) -> int:
    """Let a child read from a number on; the number to go on with."""
    context = get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)

    def note(kind: str, told: str) -> None:
        """Keep a finding about the file that was being read."""
        file = f"{job.extension[1:]}/{job.seed}/{number}"
        findings.append({"file": file, "kind": kind, "told": told[:200]})

    with tempfile.TemporaryDirectory() as folder:
        child = context.Process(target=_serve, args=(theirs, job, number, folder))
        child.start()
        theirs.close()
        try:
            assert ours.recv() == "ready"
            while number < job.last:
                if not ours.poll(LIMIT_S):
                    note("hangs", f"no answer within {LIMIT_S:g} s")
                    return number + 1
                kind, told = ours.recv()
                if kind in counts:
                    counts[kind] += 1
                else:
                    note(kind, told)
                number += 1
        except EOFError:
            child.join()
            note("crashes", f"exit code {child.exitcode}")
            number += 1
        finally:
            child.kill()
            child.join()
    return number


def _serve(pipe: Connection, job: Job, first: int, folder: str) -> None:
    """The child: read file after file and send what became of each."""
    end_with_parent()
    files = corpus(job.extension)
    path = Path(folder) / f"scan{job.extension}"
    if job.extension == ".png":
        path.with_suffix(".json").write_text(_INTRINSICS)
    terminal = os.open(Path(folder) / "stderr", os.O_RDWR | os.O_CREAT)
    os.dup2(terminal, 2)
    warnings.simplefilter("ignore")
    path.write_bytes(files[0])
    read_cloud(path)
    _limit_memory()
    pipe.send("ready")
    for number in range(first, job.last):
        path.unlink()  # a file that is cut short and written anew is put on disk at once
        path.write_bytes(job.make(files, job.extension, job.seed, number))
        kind, told = outcome_of(path)
        sys.stderr.flush()
        if os.fstat(terminal).st_size:
            kind, told = "prints", os.pread(terminal, 200, 0).decode("utf-8", "replace")
            os.truncate(terminal, 0)
            os.lseek(2, 0, os.SEEK_SET)
        pipe.send((kind, " ".join(told.split())))


def _limit_memory() -> None:
    """Let what asks for far too much fail, as MemoryError or a crash."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        most = pages * os.sysconf("SC_PAGE_SIZE") + MOST_MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


def outcome_of(path: Path) -> tuple[str, str]:
    """What reading a file comes to: "read", "refused", or a kind of finding, and what was told."""
    import numpy as np

    try:
        cloud = read_cloud(path)
    except ValueError as error:
        message = str(error)
        is_clear = str(path) in message and message.isprintable() and len(message) < LONGEST_LINE
        return "refused" if is_clear else "unclear line", message
    except BaseException as error:
        return "raises", f"{type(error).__name__}: {error}"
    if not 0 < len(cloud) <= MOST_POINTS or not np.isfinite(cloud.points_m).all():
        return "no points", f"{len(cloud)} points"
    return "read", ""
