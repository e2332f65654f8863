"""What is being done, told to whoever listens: a bar on a terminal, or a function of the caller."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from enum import Enum
from typing import TextIO, TypeVar

_Item = TypeVar("_Item")
Listener = Callable[[str, int, int], None]
"""Told a stage, how much of it is done and how much there is; 0 of 0 where nobody knows."""

_PATIENCE_S = 2.0
"""What takes less shows no bar."""
_REDRAWN_S = 0.2
_WIDTH = 24
_listeners: list[Listener] = []
_bars: list[_Bar] = []
_is_silent = False


class Terminal(Enum):
    """What a command tells while it runs and at its end."""

    table = "table"
    """A bar on a terminal, then a short table."""
    quiet = "quiet"
    """Nothing but errors; the exit code says the rest."""
    json = "json"
    """Nothing but one line of JSON on stdout at the end."""


def tell(stage: str, done: int = 0, of: int = 0) -> None:
    """Say what is being done, and how much of how much of it."""
    for listener in _listeners:
        listener(stage, done, of)


def counted(stage: str, items: Iterable[_Item], of: int) -> Iterator[_Item]:
    """The items as they come, each told."""
    tell(stage, 0, of)
    for done, item in enumerate(items, start=1):
        tell(stage, done, of)
        yield item


def say(line: str) -> None:
    """Print a line on stderr above the bar, unless all is to be silent."""
    if not _is_silent:
        clear()
        print(line, file=sys.stderr, flush=True)


def clear() -> None:
    """Take the bar away until the next stage is told; what is printed then stands alone."""
    for bar in _bars:
        bar.rest()


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Hear what is told while the block runs."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


@contextmanager
def shown(title: str, terminal: Terminal = Terminal.table) -> Iterator[None]:
    """Draw a bar while the block runs, if it takes long and stderr is a terminal; or keep silent.

    Args:
        title: what runs, such as "register".
        terminal: quiet and json also keep back what the block prints on stdout.
    """
    global _is_silent
    if terminal is Terminal.table:
        with _drawn(title, sys.stderr):
            yield
        return
    _is_silent = True
    try:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
            yield
    finally:
        _is_silent = False


@contextmanager
def _drawn(title: str, stream: TextIO) -> Iterator[None]:
    if not stream.isatty():
        yield
        return
    bar = _Bar(title, stream)
    _bars.append(bar)
    try:
        with listening(bar.take), _compilations(bar):
            yield
    finally:
        _bars.remove(bar)
        bar.end()


@contextmanager
def _compilations(bar: _Bar) -> Iterator[None]:
    """Let a bar know when loops are compiled, which happens on the first call of a machine."""
    from numba.core import event

    class Compiling(event.Listener):
        """Hears numba."""

        def on_start(self, event: object) -> None:
            """A function is being compiled."""
            bar.compiling += 1

        def on_end(self, event: object) -> None:
            """It is done."""
            bar.compiling -= 1

    listener = Compiling()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)


class _Bar:
    """One line on a terminal, drawn anew by a thread of its own while others compute."""

    def __init__(self, title: str, stream: TextIO) -> None:
        self.compiling = 0
        self._title, self._stream = title, stream
        self._start_s = time.monotonic()
        self._stage, self._counted = "", ("", 0, 0)
        self._rests, self._is_there = False, False
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._redraw, daemon=True)
        self._thread.start()

    def take(self, stage: str, done: int, of: int) -> None:
        """Note what is being done; stages within a counted one stand beside it."""
        self._rests = False
        if of:
            self._counted, self._stage = (stage, done, of), ""
        else:
            self._stage = stage

    def rest(self) -> None:
        """Erase the line until the next stage."""
        with self._lock:
            self._rests = True
            self._erase()

    def end(self) -> None:
        """Erase the line for good."""
        self._ended.set()
        self._thread.join()
        self.rest()

    def _redraw(self) -> None:
        self._ended.wait(_PATIENCE_S)
        while not self._ended.is_set():
            with self._lock:
                if not self._rests:
                    self._draw()
            self._ended.wait(_REDRAWN_S)

    def _draw(self) -> None:
        wide = shutil.get_terminal_size().columns - 1
        self._stream.write(f"\r\x1b[2K{self.line(time.monotonic() - self._start_s)[:wide]}")
        self._stream.flush()
        self._is_there = True

    def _erase(self) -> None:
        if self._is_there:
            self._stream.write("\r\x1b[2K")
            self._stream.flush()
            self._is_there = False

    def line(self, elapsed_s: float) -> str:
        """What the bar says after so many seconds."""
        stage, done, of = self._counted
        filled = round(_WIDTH * done / of) if of else 0
        at = int(elapsed_s / _REDRAWN_S) % _WIDTH
        marks = "#" * filled + "-" * (_WIDTH - filled)
        moving = "-" * at + "#" + "-" * (_WIDTH - 1 - at)
        count = f" {stage} {done}/{of}" if of else ""
        detail = "compiling loops, once per machine" if self.compiling else self._stage
        left_s = elapsed_s * (of - done) / done if of and 0 < done < of else 0
        left = f", about {in_words(left_s)} left" if left_s else ""
        parts = f"{count} {detail}".rstrip()
        return f"{self._title} [{marks if of else moving}]{parts} {in_words(elapsed_s)}{left}"


def in_words(time_s: float) -> str:
    """Seconds, or minutes and seconds."""
    minutes, seconds = divmod(round(time_s), 60)
    return f"{round(time_s)} s" if time_s < 99.5 else f"{minutes} min {seconds:02} s"
