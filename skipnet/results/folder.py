"""The folder of a run: its results appear together or not at all, and nothing of another stays."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

RESULTS = (
    "result.json",
    "aligned.*",
    "before_after.png",
    "simulated_source.ply",
    "simulated_target.ply",
    "poses.json",
    "merged.*",
    "merged_*.*",
    "scans.png",
    "report.html",
)
"""What runs of this command leave in their folder."""


@contextmanager
def new_results(folder: Path) -> Iterator[Path]:
    """Yield an empty folder inside ``folder``; move its files up once the block succeeds.

    Results of an earlier run, of whatever kind, go in the same moment, and a line says so. After an
    error everything is as it was. Runs that end at the same time do so one after the other.

    Raises:
        OSError: the results cannot be written; it names the folder.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(dir=folder, prefix=".unfinished."))
    try:
        yield staging
        _move(staging, folder)
    except OSError as error:
        if error.filename is None:
            raise OSError(f"{folder}: cannot write the results: {error}") from error
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if is_new and not any(folder.iterdir()):
            folder.rmdir()


def _move(staging: Path, folder: Path) -> None:
    with _locked(folder):
        fresh = sorted(path.name for path in staging.iterdir())
        old = sorted(
            path.name
            for path in folder.iterdir()
            if path.is_file() and any(fnmatch(path.name, pattern) for pattern in RESULTS)
        )
        if old:
            print(f"Replacing the results of an earlier run in {folder}: {', '.join(old)}")
        for name in old:
            if name not in fresh:
                (folder / name).unlink()
        for name in fresh:
            os.replace(staging / name, folder / name)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a folder against other runs; they wait for the moment that moving files takes."""
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
