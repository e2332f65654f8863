"""A method in a child process that can be stopped: a hang or a crash costs one pair."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.parallel.pools import THREAD_VARIABLES, end_with_parent, environment


def isolated(make: Callable[[], Method], limit_s: float | None = None, threads: int = 1) -> Method:
    """The method that ``make`` builds, run in a child process and stopped after ``limit_s``.

    The child is started at the first call and reused; only a stop or a crash brings a new one.
    Building the method does not count towards the limit.

    Args:
        make: picklable, called in the child.
        limit_s: wall time that one call may take; None for any.
        threads: processors that the child may use: the thread pools are told, and where the system
            can it gives the child no more (Open3D's pool does not listen).

    Returns:
        A method that raises TimeoutError past the limit, RuntimeError when the child dies, and
        whatever exception the method itself raises.
    """
    return partial(_Worker(make, threads).answer, limit_s=limit_s)


class _Worker:
    """Owner of the child process and of the pipe to it."""

    def __init__(self, make: Callable[[], Method], threads: int) -> None:
        self._make = make
        self._threads = threads
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None

    def answer(self, task: Task, limit_s: float | None) -> Estimate:
        """What the child makes of a task; see ``isolated`` for what it may raise."""
        pipe = self._pipe or self._start()
        try:
            pipe.send(task)
            if not pipe.poll(limit_s):
                self._stop()
                raise TimeoutError(f"stopped after the time limit of {limit_s:g} s")
            answer = pipe.recv()
        except (EOFError, BrokenPipeError, ConnectionResetError) as error:
            process, code = self._process, None
            if process is not None:
                process.join()
                code = process.exitcode
            self._stop()
            raise RuntimeError(f"the method's process died (exit code {code})") from error
        if isinstance(answer, Exception):
            raise answer
        estimate: Estimate = answer
        return estimate

    def _start(self) -> Connection:
        # spawn, not fork: a forked child inherits locks of thread pools that no longer have
        # threads.
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        arguments = (self._make, theirs, self._threads)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        with environment(dict.fromkeys(THREAD_VARIABLES, str(self._threads))):
            self._process.start()
        theirs.close()
        self._pipe = ours
        try:
            built = ours.recv()
        except EOFError as error:
            self._stop()
            raise RuntimeError("the method's process died while it was built") from error
        if isinstance(built, Exception):
            self._stop()
            raise built
        return ours

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def _serve(make: Callable[[], Method], pipe: Connection, threads: int) -> None:
    """The child: build the method, then answer tasks until the pipe closes."""
    _settle_in(threads)
    try:
        method = make()
    except Exception as error:
        pipe.send(error)
        return
    pipe.send("built")
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(_timed(method, task))
        except BrokenPipeError:
            return  # the run was killed meanwhile


def _settle_in(threads: int) -> None:
    """Take so many processors and die with the parent, as far as the system offers it (Linux)."""
    if hasattr(os, "sched_setaffinity"):
        processors = sorted(os.sched_getaffinity(0))
        first = os.getpid() % len(processors)
        os.sched_setaffinity(0, (processors[first:] + processors[:first])[:threads])
    end_with_parent()


def _timed(method: Method, task: Task) -> Estimate | Exception:
    """The method's answer and how long it took, or its exception."""
    started = time.perf_counter()
    try:
        return replace(method(task), time_s=time.perf_counter() - started)
    except Exception as error:
        return error
