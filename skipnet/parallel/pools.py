"""Child processes and threads that compute with one BLAS thread: they do not wait for others."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Of mallopt(3): how much freed memory is kept, and from which size on none is."""
PR_SET_PDEATHSIG = 1
"""Of Linux's prctl(2): the signal that a process gets when its parent ends."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Each = Callable[..., Iterator[Any]]
"""``map``, or what does the same in other processes."""


def keep_freed_memory() -> None:
    """Let this process use freed memory again, where the C library can be told to (glibc).

    Left alone, it gives large blocks back to the system at once and gets the next ones anew, page
    after page and cleared: a tenth of a training step.
    """
    if sys.platform == "linux" and (tell := getattr(ctypes.CDLL(None), "mallopt", None)):
        for option, most_bytes in ((M_MMAP_THRESHOLD, 32 << 20), (M_TRIM_THRESHOLD, 1 << 30)):
            tell(option, most_bytes)


def end_with_parent() -> None:
    """Let this child end when its parent does, and leave interrupts from the keyboard to it.

    A killed parent cannot stop its children: they would run on for minutes, or wait for ever. (Only
    Linux tells a child of its parent's end.)
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


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
    with (
        environment(one_thread),
        ProcessPoolExecutor(workers, mp_context=fresh, initializer=end_with_parent) as pool,
    ):
        try:
            yield pool
        except BaseException:
            # Else the pool waits for what its workers do at the moment, which nobody wants now.
            for worker in list((pool._processes or {}).values()):
                worker.kill()
            raise


@contextmanager
def mapping(workers: int) -> Iterator[Each]:
    """``map`` over so many processes; with one, over this one."""
    if workers == 1:
        yield map
        return
    with worker_pool(workers) as pool:
        yield pool.map
