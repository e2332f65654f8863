"""Loops over points and voxels as machine code (numba)."""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, TypeVar

from numba import config, njit
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    NullCache,
)
from numba.core.runtime import rtsys

_Function = TypeVar("_Function", bound=Callable[..., object])
INSTALLED = Path(__file__).parent / "machine_code"
"""Filled when a wheel is built (``building/backend.py``); a checkout has none."""


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call, once per machine, and let other threads run meanwhile.

    Arguments are arrays and numbers; each combination of their types is compiled apart. Where the
    package was installed with machine code for this processor, Python and numba (``INSTALLED``),
    that is run. Other code is kept beside the source, or in the user's cache where that folder
    cannot be written, or where neither can in a folder for temporary files, which is said;
    ``NUMBA_CACHE_DIR`` names another. Where the disk is full it is not kept, which is said; what is
    damaged is made anew.

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
    options = {"forceinline": forceinline, "nogil": True, "error_model": "numpy"}
    made = njit(**options)(function)  # type: ignore[call-overload]
    made._cache = _Kept(function)
    return made


class _Cache(FunctionCache):
    """numba's, without what compiling needs and running does not."""

    def load_overload(self, sig: object, target_context: Any) -> Any:
        """The machine code for these types, or None.

        numba would first import all that it can compile, SciPy among it: a quarter of a second.
        When something is compiled it does so then.
        """
        rtsys.initialize(target_context)  # of what is kept some allocates arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


class _Kept(NullCache):
    """Machine code of one function: what was installed, else what this machine has kept.

    No folder is looked for before a function needs it.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        self._function = function

    @cached_property
    def _installed(self) -> _Cache | None:
        with suppress(RuntimeError):  # there is none for this function
            return _InstalledCache(self._function)
        return None

    @cached_property
    def _own(self) -> _Cache | None:
        """numba's choice of a folder, else one for temporary files; None where there is neither."""
        with suppress(RuntimeError):  # numba finds no folder for its cache
            return _Cache(self._function)
        if (folder := _temporary_cache()) is None:
            return None
        options = vars(config)  # read by numba whenever a cache is made
        saved, options["CACHE_DIR"] = options["CACHE_DIR"], folder
        try:
            with suppress(RuntimeError):
                return _Cache(self._function)
        finally:
            options["CACHE_DIR"] = saved
        return None

    def load_overload(self, *signature_and_target: Any) -> Any:
        """What is kept for these types, or None; without what cannot be read."""
        with suppress(Exception):
            if self._installed and (found := self._installed.load_overload(*signature_and_target)):
                return found
        if self._own is None:
            return None
        try:
            return self._own.load_overload(*signature_and_target)
        except Exception:  # a file that was cut off when the power went, say
            with suppress(OSError):
                self._own.flush()
            return None

    def save_overload(self, *signature_and_code: Any) -> None:
        """Keep what was compiled, if there is a folder and room in it."""
        if self._own is None:
            return
        try:
            self._own.save_overload(*signature_and_code)
        except OSError as error:
            _say_not_kept(self._own.cache_path, error.strerror or str(error))


class InstalledLocator(InTreeCacheLocator):
    """Where ``pip install`` put machine code: a folder of the package, which is read alone.

    A name for ``NUMBA_CACHE_LOCATOR_CLASSES`` while the package is built, which lets numba write
    there.
    """

    def __init__(self, py_func: Callable[..., object], py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._cache_path = str(INSTALLED / Path(py_file).parent.relative_to(INSTALLED.parent))

    def get_source_stamp(self) -> str:
        """What the file says: the time that it was written is another once it is installed."""
        return _digest(self._py_file)

    @classmethod
    def from_function(cls, py_func: Callable[..., object], py_file: str) -> InstalledLocator | None:
        """None for functions outside the package, and where nothing was installed."""
        is_ours = INSTALLED.is_dir() and Path(py_file).is_relative_to(INSTALLED.parent)
        return cls(py_func, py_file) if is_ours else None


class _InstalledImplementation(CompileResultCacheImpl):
    _locator_classes = [InstalledLocator]


class _InstalledCache(_Cache):
    _impl_class = _InstalledImplementation  # type: ignore[assignment]


@cache
def _digest(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


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
