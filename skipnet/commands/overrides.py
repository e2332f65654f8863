"""Overrides of the command line are checked against the schema before Hydra sees them."""

from __future__ import annotations

import difflib
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, NoReturn, get_type_hints


def check_overrides(arguments: Sequence[str], schema: type, config_dir: Path) -> Namespace:
    """Raise a ValueError for the first override that names no option, with the nearest that exists.

    Hydra's own options (``hydra.*``, ``hydra/*``) and flags (``--help``) are left to Hydra.

    Returns:
        The arguments as Hydra's parser takes them apart: its flags, and the ``overrides``.
    """
    from hydra._internal.utils import get_args_parser
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    flags_parser = get_args_parser()
    flags_parser.error = _refuse  # type: ignore[method-assign]  # else it prints Hydra's own flags
    flags = flags_parser.parse_args(list(arguments))
    for argument in flags.overrides:
        if "=" not in argument[1:] and not argument.startswith("~"):
            raise ValueError(f"{argument!r} is not an override: write option=value")
        try:
            override = parser.parse_override(argument)
        except Exception as error:
            raise ValueError(
                f"cannot read {argument!r}: a value with ()[]{{}}=,: in it needs quotes in quotes, "
                f"'key=\"value\"'"
            ) from error
        key = override.key_or_group
        if key.split(".")[0].split("/")[0] == "hydra":
            continue
        _check_key(key, schema, config_dir)
        if (config_dir / key).is_dir():
            _check_choice(key, override.get_value_string(), [config_dir, *_own(flags)])
        if override.is_delete():
            raise ValueError(
                f"{argument}: an option cannot be removed; leave it out, or give it a value"
            )
    return flags


def _refuse(message: str) -> NoReturn:
    raise ValueError(f"{message}; options are written option=value, --help shows them")


def _check_key(key: str, schema: type, config_dir: Path) -> None:
    options = dict(_options(schema))
    groups = [folder.name for folder in config_dir.iterdir() if folder.is_dir()]
    # Below an option that may hold anything (the optimiser's own arguments) every key is fine.
    parents = [".".join(key.split(".")[: n + 1]) for n in range(key.count("."))]
    if key in options or key in groups or any(options.get(parent) == "open" for parent in parents):
        return
    near = difflib.get_close_matches(key, [*options, *groups], n=1, cutoff=0.5)
    first = dict.fromkeys(name for name in [*options, *groups] if "." not in name)
    hint = f"did you mean {near[0]}?" if near else "the options are " + ", ".join(first)
    raise ValueError(f"no such option: {key}; {hint}")


def _own(flags: Namespace) -> list[Path]:
    """The user's folder of groups and presets, which Hydra's ``--config-dir`` names."""
    return [Path(flags.config_dir)] if flags.config_dir else []


def _check_choice(group: str, value: str, folders: Sequence[Path]) -> None:
    """Refuse a preset that a config group does not have; lists and sweeps name several."""
    choices = sorted(file.stem for folder in folders for file in (folder / group).glob("*.yaml"))
    for choice in (one.strip("\"'") for one in value.strip("[]").split(",")):
        if choice not in choices:
            raise ValueError(f"no such choice: {group}={choice}; choose from {', '.join(choices)}")


def _options(schema: type, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Every dotted option, and whether it is a "leaf", a "section" or "open" to any key."""
    hints = get_type_hints(schema)
    for field in fields(schema):
        kind = hints[field.name]
        if is_dataclass(kind):
            yield prefix + field.name, "section"
            yield from _options(kind, f"{prefix}{field.name}.")  # type: ignore[arg-type]
        else:
            is_open = kind is Any or getattr(kind, "__origin__", None) is dict
            yield prefix + field.name, "open" if is_open else "leaf"
