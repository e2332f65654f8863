"""Peak memory of one registration, measured in a process of its own."""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Task, make_method
from skipnet.types import FloatArray, Pair

_BYTES_PER_RSS_UNIT = 1 if sys.platform == "darwin" else 1024


def task_of(pair: Pair) -> Task:
    """What a method sees of a pair."""
    return Task(pair.source_m, pair.target_m, pair.source_viewpoint_m, pair.target_viewpoint_m)


def peak_bytes(recipe: tuple[str, Mapping[str, Any]], pair: Pair, small: Pair) -> int | None:
    """Peak memory of one call beyond its input, in a process of its own; None if it died.

    Args:
        recipe: path of the function that makes the method, and its options.
        pair: to register.
        small: registered before, so that modules loaded late do not count.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{name}.npy" for name in ("source", "target")]
        np.save(paths[0], pair.source_m)
        np.save(paths[1], pair.target_m)
        viewpoints_m = pair.source_viewpoint_m, pair.target_viewpoint_m
        arguments = recipe, paths, viewpoints_m, task_of(small), theirs
        child = context.Process(target=_report_peak, args=arguments)
        child.start()
        theirs.close()
        try:
            extra: int | None = ours.recv()
        except EOFError:
            extra = None
        child.join()
    return extra


def _report_peak(
    recipe: tuple[str, Mapping[str, Any]],
    paths: list[Path],
    viewpoints_m: tuple[FloatArray | None, FloatArray | None],
    small: Task,
    pipe: Connection,
) -> None:
    """The child: how far the peak of resident memory rises above where it stood before the call."""
    method = make_method(*recipe)
    method(small)
    task = Task(np.load(paths[0]), np.load(paths[1]), *viewpoints_m)
    before = _memory_bytes()[0]
    method(task)
    pipe.send(max(_memory_bytes()[1] - before, 0))


def _memory_bytes() -> tuple[int, int]:
    """Resident memory of this process, now and at its peak; on other systems than Linux the peak.

    Linux's own figures, because ``getrusage`` lets a child start at its parent's peak.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        now, peak = (int(lines[name].split()[0]) * 1024 for name in ("VmRSS", "VmHWM"))
        return now, peak
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _BYTES_PER_RSS_UNIT
    return peak, peak
