"""Machines as they are: nothing can be written, little may be used."""

from __future__ import annotations

import math
import os
import stat
import subprocess
import sys

import pytest

from skipnet.parallel import threads

COMPILED = """
import numpy as np
from skipnet.clouds.cleaning import _all_usable
print(_all_usable(np.ones((2, 3))))
"""


def run(folder):
    """What a process says that finds no other place for compiled code than a temporary one."""
    places = {"TMPDIR": str(folder), "NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    command = [sys.executable, "-c", COMPILED]
    environment = {**os.environ, **places}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return done.stderr


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no users on this system")
def test_compiled_code_is_kept_where_it_can_be_and_it_is_said_once(tmp_path):
    told = run(tmp_path)
    folder = tmp_path / f"skipnet-{os.getuid()}"
    assert told.count("\n") == 1 and f"compiled code is kept in {folder}" in told
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert list(folder.rglob("*.nbi"))
    folder.chmod(0o777)  # others could have put anything there
    told = run(tmp_path)
    assert told.count("\n") == 1 and "compiled anew" in told and "open to others" in told


def test_compiled_code_that_was_cut_off_is_made_anew(tmp_path):
    run(tmp_path)
    for pattern in ("*.nbi", "*.nbc"):
        for path in tmp_path.rglob(pattern):
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        assert run(tmp_path).count("\n") == 1
        kept = {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}
        run(tmp_path)
        assert len(kept) == 2 and all(path.read_bytes() == kept[path] for path in kept)


ELSEWHERE = """
from skipnet.features.primitives import _add_up
_add_up(np.ones((3, 2)), np.ones((1, 2), bool))
"""
FULL = """
import errno, os
import numba.core.caching as caching
def is_full(self, key, data): raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
caching.IndexDataCacheFile.save = is_full
"""


def test_a_full_disk_keeps_no_compiled_code_and_that_is_said_once(tmp_path):
    places = {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", FULL + COMPILED + ELSEWHERE],
        capture_output=True, text=True, env={**os.environ, **places}, check=True,
    )  # fmt: skip
    assert done.stdout == "True\n"
    assert done.stderr.count("\n") == 1 and "No space left" in done.stderr
    assert str(tmp_path) in done.stderr


@pytest.mark.parametrize(
    ("limits", "processors"),
    [({}, math.inf), ({"": "max 100000"}, math.inf), ({"a": "150000 100000"}, 1.5),
     ({"a": "400000 100000", "a/b": "max 100000"}, 4), ({"a": "broken"}, math.inf)],
)  # fmt: skip
def test_a_container_may_allow_fewer_processors(tmp_path, limits, processors):
    for name, limit in limits.items():
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        (tmp_path / name / "cpu.max").write_text(limit + "\n")
    own = tmp_path / "own"
    own.write_text("1:name=x:/\n0::/a/b\n")
    assert threads._quota(tmp_path, own) == processors
    assert threads._quota(tmp_path, tmp_path / "none") == math.inf


@pytest.mark.parametrize(("quota", "expected"), [(0.2, 1), (1.5, 2), (math.inf, 3)])
def test_processors_are_whole_and_one_at_least(monkeypatch, quota, expected):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    monkeypatch.setattr(threads, "_quota", lambda: quota)
    assert threads.processors() == expected
