"""Two threads that stay, and one BLAS thread in each."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ContextDecorator
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

_Result = TypeVar("_Result")


def side_by_side(function: Callable[..., _Result], *columns: Iterable[Any]) -> list[_Result]:
    """``list(map(function, *columns))``, with the calls spread over this thread and others.

    For few long calls that mostly leave Python's lock alone. This thread makes calls too: were it
    to wait, the system might well put two others on the processor that it has just left.

    Raises:
        Exception: that of the first call, in their order, that failed; none begins after that.
    """
    calls = list(zip(*columns, strict=True))
    results: dict[int, _Result] = {}
    errors: dict[int, Exception] = {}
    numbers = iter(range(len(calls)))

    def work() -> None:
        """Make calls while there are some, and none has failed."""
        for number in numbers:
            try:
                results[number] = function(*calls[number])
            except Exception as error:
                errors[number] = error
            if errors:
                break

    helpers = min(processors(), len(calls)) - 1
    others = [_helpers().submit(work) for _ in range(helpers)]
    work()
    for other in others:
        if not other.cancel():  # else it has not begun, because all helpers are busy
            other.result()
    if errors:
        raise errors[min(errors)]
    return [results[number] for number in range(len(calls))]


def processors() -> int:
    """How many of the machine's processors this process may use: a container may allow it fewer."""
    if not hasattr(os, "sched_getaffinity"):
        return os.cpu_count() or 1
    return math.ceil(min(len(os.sched_getaffinity(0)), max(_quota(), 1)))


@cache
def _quota(groups: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> float:
    """Processors' worth of time that Linux grants this process; infinite where it is not limited.

    Args:
        groups: where the control groups are mounted (version 2).
        own: names the group of this process below it.
    """
    try:
        lines = own.read_text().splitlines()
        name = next(line[3:] for line in lines if line.startswith("0::"))
    except (OSError, StopIteration, UnicodeDecodeError):
        return math.inf
    group = groups / name.lstrip("/")
    limits = [math.inf]
    for folder in (group, *group.parents):
        try:
            most, period = (folder / "cpu.max").read_text().split()
            limits.append(float(most) / float(period))
        except (OSError, ValueError):  # "max", or no such file
            continue
    return min(limits)


@cache
def _helpers() -> ThreadPoolExecutor:
    """Threads that stay, because to start one takes as long as a short call."""
    return ThreadPoolExecutor(processors(), thread_name_prefix="skipnet")


if hasattr(os, "register_at_fork"):  # a forked child has none of them
    os.register_at_fork(after_in_child=_helpers.cache_clear)


class _OneBlasThread(ContextDecorator):
    """See ``one_blas_thread``."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._inside = 0
        self._modules = 0

    def __enter__(self) -> None:
        from threadpoolctl import ThreadpoolController

        with self._lock:
            if self._inside == 0:
                if len(sys.modules) != self._modules:  # else no other BLAS has come since
                    self._modules, self._controller = len(sys.modules), ThreadpoolController()
                self._limit = self._controller.limit(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *error: object) -> None:
        from threadpoolctl import OpenBLASController

        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                # threadpoolctl lets only the thread that set a limit lift it; here any may be last.
                OpenBLASController.clear_controlling_thread(force=True)
                self._limit.restore_original_limits()
                OpenBLASController.clear_controlling_thread(force=True)


one_blas_thread = _OneBlasThread()
"""In its body, or in a function that it decorates, NumPy computes a product in the calling thread;
so does every other BLAS that is loaded by then.

Two scans are described in two threads. Left alone, BLAS starts others for the products of each,
lets one product wait for another, and its idle threads spin for a while: describing and matching
two scans took 1.4 times as long and twice the processor time. BLAS has one setting for the whole
process, other threads of the user's too: whoever enters first makes it, whoever leaves last undoes
it."""
