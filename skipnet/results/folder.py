"""The folder of a run: its results appear together or not at all, and nothing of another stays."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path

from skipnet.storage import UNFINISHED, naming

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

    Results of an earlier run, of whatever kind, go in the same moment; what will go is said before.
    After an error everything is as it was. The caller owns the folder (``storage.owned``).

    Raises:
        OSError: the results cannot be written; it names the file, or the folder.
    """
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    if old := _earlier(folder):
        print(f"{folder}: results of an earlier run will be replaced: {', '.join(old)}", flush=True)
    staging = Path(tempfile.mkdtemp(dir=folder, prefix=UNFINISHED))
    try:
        with naming(folder):
            yield staging
            _move(staging, folder)
    except OSError as error:
        # What could not be written is named as it would have been called, not as it is not yet.
        if error.filename is not None and Path(os.fsdecode(error.filename)).parent == staging:
            named = folder / Path(os.fsdecode(error.filename)).name
            raise OSError(error.errno, error.strerror, str(named)) from error
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if is_new and not any(folder.iterdir()):
            folder.rmdir()


def _earlier(folder: Path) -> list[str]:
    """Names of the results that are in the folder."""
    return sorted(
        path.name
        for path in folder.iterdir()
        if path.is_file() and any(fnmatch(path.name, pattern) for pattern in RESULTS)
    )


def _move(staging: Path, folder: Path) -> None:
    """Replace what is there; the JSON file goes first and comes last: with it the rest is whole."""
    fresh = sorted((path.name for path in staging.iterdir()), key=_is_sign)
    for name in sorted(_earlier(folder), key=_is_sign, reverse=True):
        if name not in fresh or _is_sign(name):
            (folder / name).unlink()
    for name in fresh:
        os.replace(staging / name, folder / name)


def _is_sign(name: str) -> bool:
    return name.endswith(".json")
