"""Words of the command line as people type them: names of files need no quotes for Hydra."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import get_type_hints

_PLAIN = re.compile(r"[A-Za-z_/.][A-Za-z0-9_/.-]*")
"""What Hydra reads as the text that it is."""
_VALUES = ("true", "false", "null", "nan", "inf")
_SWEEPS = {"-m", "--multirun"}


def as_typed(arguments: Sequence[str], schema: type) -> list[str]:
    """Put in quotes what Hydra would otherwise take apart: the values of options that hold text.

    A text in quotes, null and what holds an interpolation ``${...}`` are left as they are, and so
    is in a sweep a text with commas, unless it is the name of a file. A list of texts may be
    typed as one text, or in brackets, whose commas part the names unless these files exist
    with the commas in their names.

    Args:
        arguments: as the shell passes them.
        schema: dataclass of the options.

    >>> from skipnet.commands.register import RegisterConfig
    >>> as_typed(["source=scan (copy).ply", "seed=1", "scans=[a.ply,b#.ply]"], RegisterConfig)
    ['source="scan (copy).ply"', 'seed=1', 'scans=[a.ply,"b#.ply"]']
    """
    hints = get_type_hints(schema)
    in_sweep = bool(_SWEEPS & set(arguments))
    return [_typed(argument, hints, in_sweep) for argument in arguments]


def plain_options(arguments: Sequence[str], schema: type) -> dict[str, str] | None:
    """The options that arguments give, if all are options that hold text, each given once, with
    texts that Hydra would read as they are; else None.

    Args:
        arguments: of ``as_typed``.
        schema: dataclass of the options.

    >>> from skipnet.commands.register import RegisterConfig
    >>> plain_options(["source=a.ply", "output_dir=out"], RegisterConfig)
    {'source': 'a.ply', 'output_dir': 'out'}
    >>> plain_options(["source=a.ply", "seed=1"], RegisterConfig)
    """
    hints, given = get_type_hints(schema), dict[str, str]()
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key in given or hints.get(key) not in (str, str | None) or not _is_plain(value):
            return None
        given[key] = value
    return given


def _typed(argument: str, hints: dict[str, object], in_sweep: bool) -> str:
    key, mark, value = argument.partition("=")
    kind = hints.get(key.lstrip("+"))
    if not mark or kind not in (str, str | None, list[str]):
        return argument
    if value[:1] in ('"', "'") and value[-1:] == value[:1] and len(value) > 1:
        return argument
    if in_sweep and "," in value and not Path(value).exists():
        return argument
    if kind == list[str]:
        return f"{key}=[{','.join(map(_quoted, _names(value)))}]"
    return argument if value in ("", "null") else f"{key}={_quoted(value)}"


def _names(value: str) -> list[str]:
    """The names in a list: the longest that exist as files, else the pieces between commas."""
    is_list = value.startswith("[") and value.endswith("]") and not Path(value).exists()
    if not is_list:
        return [value]
    pieces, names = value[1:-1].split(","), []
    while pieces and (len(pieces) > 1 or pieces[0]):
        takes = next(
            (n for n in range(len(pieces), 1, -1) if Path(",".join(pieces[:n]).strip()).exists()), 1
        )
        names.append(",".join(pieces[:takes]).strip())
        pieces = pieces[takes:]
    return names


def _quoted(value: str) -> str:
    in_quotes = value[:1] in ('"', "'") and value[-1:] == value[:1] and len(value) > 1
    if in_quotes or "${" in value or _is_plain(value):
        return value
    # Of backslashes only those before a quote mean something to Hydra.
    escaped = re.sub(r'(\\*)"', r'\1\1\\"', value)
    escaped = re.sub(r"(\\+)$", r"\1\1", escaped)
    return f'"{escaped}"'


def _is_plain(value: str) -> bool:
    return _PLAIN.fullmatch(value) is not None and value.lower() not in _VALUES
