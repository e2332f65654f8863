"""Loops over points and voxels as machine code (numba)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call, once per machine, and let other threads run meanwhile.

    Arguments are arrays and numbers; each combination of their types is compiled apart. The machine
    code is kept beside the source, or in the user's cache where that folder cannot be written, and
    compiled anew by every process where neither can.

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
    def compile_(cache: bool) -> _Function:
        """With a cache or without."""
        options = {"forceinline": forceinline, "nogil": True, "error_model": "numpy"}
        return njit(cache=cache, **options)(function)  # type: ignore[call-overload]

    try:
        return compile_(cache=True)
    except RuntimeError:  # numba finds no folder for its cache
        return compile_(cache=False)
