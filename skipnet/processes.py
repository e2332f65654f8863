"""Child processes and threads that compute with one BLAS thread: they do not wait for others."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ContextDecorator, contextmanager
from functools import cache
from multiprocessing import get_context
from threading import Lock
from typing import Any, TypeVar

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Of mallopt(3): how much freed memory is kept, and from which size on none is."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Each = Callable[..., Iterator[Any]]
"""``map``, or what does the same in other processes."""
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
    """How many of the machine's processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _helpers() -> ThreadPoolExecutor:
    """Threads that stay, because to start one takes as long as a short call."""
    return ThreadPoolExecutor(processors(), thread_name_prefix="skipnet")


if hasattr(os, "register_at_fork"):  # a forked child has none of them
    os.register_at_fork(after_in_child=_helpers.cache_clear)


def keep_freed_memory() -> None:
    """Let this process use freed memory again, where the C library can be told to (glibc).

    Left alone, it gives large blocks back to the system at once and gets the next ones anew, page
    after page and cleared: a tenth of a training step.
    """
    if sys.platform == "linux" and (tell := getattr(ctypes.CDLL(None), "mallopt", None)):
        for option, most_bytes in ((M_MMAP_THRESHOLD, 32 << 20), (M_TRIM_THRESHOLD, 1 << 30)):
            tell(option, most_bytes)


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


@contextmanager
def environment(values: dict[str, str]) -> Iterator[None]:
    """Set variables that a child reads as it starts."""
    saved = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in saved.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of so many processes, which start as work comes.

    Left alone, BLAS and OpenMP start a thread per processor in every process, and those of one
    process spin while those of another compute: simulating on two processors took a third longer.
    """
    # Fresh processes: a forked one would inherit the locks of Open3D's and torch's threads.
    fresh = get_context("spawn")
    one_thread = dict.fromkeys(THREAD_VARIABLES, "1")
    with environment(one_thread), ProcessPoolExecutor(workers, mp_context=fresh) as pool:
        yield pool


@contextmanager
def mapping(workers: int) -> Iterator[Each]:
    """``map`` over so many processes; with one, over this one."""
    if workers == 1:
        yield map
        return
    with worker_pool(workers) as pool:
        yield pool.map
