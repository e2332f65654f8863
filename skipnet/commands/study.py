"""Ask one question about the method: ``skipnet study vigilance``, ``skipnet study --help``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from skipnet.checks import suggestion
from skipnet.commands import hydra_app
from skipnet.commands.errors import EXIT_BAD_INPUT, EXIT_OK
from skipnet.studies.options import STUDIES


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study that the first argument names; its exit code."""
    name, *rest = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if name in ("--help", "-h", "help"):
        print(_usage())
        return EXIT_OK
    if name not in STUDIES:
        print(f"study: no study {name!r}{suggestion(name, tuple(STUDIES))}", file=sys.stderr)
        return EXIT_BAD_INPUT

    def study(config: Any) -> dict[str, Any]:
        """The study's own module is imported when its options are known to be right."""
        summary: dict[str, Any] = import_module(f"skipnet.studies.{name}").run(config)
        return summary

    return hydra_app.run(f"study/{name}", STUDIES[name], study, arguments=rest)


def _usage() -> str:
    questions = {name: (schema.__doc__ or "").split("\n")[0] for name, schema in STUDIES.items()}
    lines = [f"  skipnet study {name:12s} {question}" for name, question in questions.items()]
    return "\n".join([*lines, "", "Each has --help, and writes a report into its output_dir."])
