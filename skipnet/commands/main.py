"""The console command ``skipnet register|evaluate|train|study|compile``, or python -m skipnet."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

from skipnet.checks import suggestion
from skipnet.commands.errors import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_OK
from skipnet.provenance import __version__

COMMANDS = {
    "register": "bring two or more scans into one frame",
    "evaluate": "compare registration methods on the same pairs",
    "train": "train the network on simulated scenes",
    "study": "ask one question about the method",
    "compile": "make machine code now, which the first registration would wait for",
}
"""Each is a module of this room with a ``main``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Hand the arguments on to the command that the first one names; its exit code."""
    name, *rest = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("--help", "-h", "help"):
        print(_usage())
        return EXIT_OK
    if name == "--version":
        print(__version__)
        return EXIT_OK
    if name not in COMMANDS:
        print(f"skipnet: no command {name!r}{suggestion(name, tuple(COMMANDS))}", file=sys.stderr)
        return EXIT_BAD_INPUT
    try:
        return int(import_module(f"skipnet.commands.{name}").main(rest))
    except KeyboardInterrupt:  # while the command itself is imported
        print(f"{name}: interrupted; nothing was begun", file=sys.stderr)
        return EXIT_INTERRUPTED


def _usage() -> str:
    lines = [f"  skipnet {name:10s} {effect}" for name, effect in COMMANDS.items()]
    return "\n".join(
        ["Markerless registration of 3D scans.", "", *lines, "", "Each has --help; --version too."]
    )
