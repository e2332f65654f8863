"""Loops over points and voxels as machine code (numba)."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, TypeVar

from numba import config, njit

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call, once per machine, and let other threads run meanwhile.

    Arguments are arrays and numbers; each combination of their types is compiled apart. The machine
    code is kept beside the source, or in the user's cache where that folder cannot be written, or
    where neither can in a folder for temporary files, which is said; ``NUMBA_CACHE_DIR`` names
    another. Where the disk is full it is not kept, which is said; what is damaged is made anew.

    What is kept is known to be stale when the function's own file has changed, not when another
    has: a compiled function uses nothing that its module imports from skipnet, which
    ``tests/test_compiled.py`` checks. Sums are taken in the order in which they are written, so the
    same input gives the same bits.
    """
    return _compile(function)


def inlined(function: _Function) -> _Function:
    """As ``compiled``, for a function that compiled ones call: there it becomes part of their loop,
    so that the compiler can take several turns of it at a time."""
    return _compile(function, forceinline=True)


def _compile(function: _Function, forceinline: bool = False) -> _Function:
    def compile_(kept: bool) -> _Function:
        """With a cache or without."""
        options = {"forceinline": forceinline, "nogil": True, "error_model": "numpy"}
        made = njit(cache=kept, **options)(function)  # type: ignore[call-overload]
        if kept:
            _forgive(made._cache)
        return made

    with suppress(RuntimeError):  # numba finds no folder for its cache
        return compile_(kept=True)
    if (folder := _temporary_cache()) is None:
        return compile_(kept=False)
    options = vars(config)  # read by numba whenever a function is marked
    saved, options["CACHE_DIR"] = options["CACHE_DIR"], folder
    try:
        with suppress(RuntimeError):
            return compile_(kept=True)
    finally:
        options["CACHE_DIR"] = saved
    return compile_(kept=False)


def _forgive(kept: Any) -> None:
    """Let numba go without what it keeps where it cannot be read, or written for lack of room."""
    load, save = kept.load_overload, kept.save_overload

    def load_or_compile(*signature_and_target: Any) -> Any:
        try:
            return load(*signature_and_target)
        except Exception:  # a file that was cut off when the power went, say
            with suppress(OSError):
                kept.flush()
            return None

    def save_if_possible(*signature_and_code: Any) -> None:
        try:
            save(*signature_and_code)
        except OSError as error:
            _say_not_kept(kept.cache_path, error.strerror or str(error))

    kept.load_overload, kept.save_overload = load_or_compile, save_if_possible


_told: set[str] = set()
"""Why something was not kept, as far as it has been said; folders there are many."""


def _say_not_kept(folder: str, reason: str) -> None:
    if parent_process() is None and reason not in _told:
        _told.add(reason)
        print(
            f"skipnet: compiled code is not kept in {folder}: {reason} "
            "(NUMBA_CACHE_DIR names another folder)",
            file=sys.stderr,
        )


@cache
def _temporary_cache() -> str | None:
    """A folder for temporary files of this user's alone, since what is in it will be run.

    Says which it is, or that there is none: then every process compiles for some twenty seconds.
    """
    name = f"skipnet-{os.getuid()}" if hasattr(os, "getuid") else "skipnet"
    folder = Path(tempfile.gettempdir()) / name
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        is_own = stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o077
        if not is_own or (hasattr(os, "getuid") and found.st_uid != os.getuid()):
            raise PermissionError(f"{folder} is open to others")
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        print(f"skipnet: compiled anew by every process: {error}", file=sys.stderr)
        return None
    if parent_process() is None:  # else it has been said
        print(
            f"skipnet: compiled code is kept in {folder}, as neither the package's folder nor the "
            "user's cache can be written (NUMBA_CACHE_DIR names another)",
            file=sys.stderr,
        )
    return str(folder)
