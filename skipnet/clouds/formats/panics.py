"""The decompressor of LAZ is written in Rust, whose panics write a page to the terminal."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_TERMINAL = 2
_one_at_a_time = Lock()


@contextmanager
def without_trace() -> Iterator[None]:
    """Keep a panic's trace from the terminal; the error says it. All other words get there, those
    of other threads too, at the end of the block."""
    with _one_at_a_time, tempfile.TemporaryFile() as kept:
        try:
            terminal = os.dup(_TERMINAL)
        except OSError:  # closed: then nobody sees it anyhow
            yield
            return
        os.dup2(kept.fileno(), _TERMINAL)
        panicked = False
        try:
            yield
        except BaseException as error:
            panicked = type(error).__name__ == "PanicException"
            raise
        finally:
            os.dup2(terminal, _TERMINAL)
            os.close(terminal)
            kept.seek(0)
            if words := (b"" if panicked else kept.read()):
                os.write(_TERMINAL, words)
