"""What the three scripts share: a Hydra task whose user errors are one clear line, not a traceback.

Hydra composes ``configs/NAME.yaml`` with the overrides of the command line. Keys are checked
against the schema *before* that, because Hydra lets ``+key`` pass silently and answers a misspelt
one with a page.
"""

from __future__ import annotations

import difflib
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from string import Template
from typing import Any, TypeVar, get_type_hints

Config = TypeVar("Config")
Result = TypeVar("Result")

EXIT_OK = 0
EXIT_BAD_INPUT = 2
EXIT_NOT_REGISTERED = 3

# Set to 1, this environment variable of Hydra's brings the traceback of every error.
FULL_ERROR = "HYDRA_FULL_ERROR"

# What Open3D loads and a bare Debian lacks.
DEBIAN_LIBRARIES = "libusb-1.0-0 libgl1 libegl1 libgomp1"

# What a user can mend. Anything else is a bug of ours and keeps its traceback.
USER_ERRORS = (ValueError, OSError, ImportError)


def run(
    name: str,
    schema: type[Config],
    task: Callable[[Config], Result],
    config_dir: Path,
    exit_code: Callable[[Result], int] = lambda result: EXIT_OK,
    arguments: Sequence[str] | None = None,
) -> int:
    """Run ``task`` on the configuration that the command line describes.

    Args:
        name: of the script; its Hydra config is ``config_dir/NAME.yaml``, which lists
            ``NAME_schema`` first in its defaults.
        schema: dataclass of the options; made anew from the composed values, so that its
            ``__post_init__`` checks the ranges.
        task: one library function behind a thin wrapper.
        config_dir: folder of the YAML files; its folders are config groups.
        exit_code: what the task's result means for the shell.
        arguments: overrides and Hydra flags; default: those of the process.

    Returns:
        The exit code: 2 for bad input, after one line on stderr; otherwise ``exit_code(result)``,
        and the highest of them after a sweep (``--multirun``), whose runs get a folder each,
        numbered from 0, as their ``output_dir``.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        flags = check_overrides(arguments, schema, config_dir)
        if flags.help:
            print(_help(name, schema, config_dir, flags.overrides))
            return EXIT_OK
        return _run_hydra(name, schema, task, config_dir, exit_code, arguments)
    except Exception as error:
        if not is_user_error(error) or os.environ.get(FULL_ERROR) == "1":
            raise
        print(f"{name}: {one_line(error)}", file=sys.stderr)
        return EXIT_BAD_INPUT


def is_user_error(error: BaseException) -> bool:
    """Whether the user can mend this: bad values, files, packages, options."""
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    if isinstance(error, ImportError) and (error.name or "").split(".")[0] == "skipnet":
        return False
    return isinstance(error, (*USER_ERRORS, HydraException, OmegaConfBaseException))


def one_line(error: BaseException) -> str:
    """The error's message without line breaks; OSErrors name their file, Hydra's their cause.

    >>> one_line(ValueError("too few points:\\n  got 2"))
    'too few points: got 2'
    """
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    message = " ".join(str(error).split()) or type(error).__name__
    if "cannot open shared object file" in message:
        return f"{message}; on Debian: apt-get install {DEBIAN_LIBRARIES}"
    if type(error).__module__.startswith("hydra") and error.__cause__ is not None:
        # OmegaConf's first line says what is wrong, the others where in its own classes.
        return f"{message}: {str(error.__cause__).splitlines()[0]}"
    return message


def check_overrides(arguments: Sequence[str], schema: type, config_dir: Path) -> Namespace:
    """Raise a ValueError for the first override that names no option, with the nearest that exists.

    Hydra's own options (``hydra.*``, ``hydra/*``) and flags (``--help``) are left to Hydra.

    Returns:
        The arguments as Hydra's parser takes them apart: its flags, and the ``overrides``.
    """
    from hydra._internal.utils import get_args_parser
    from hydra.core.override_parser.overrides_parser import OverridesParser

    parser = OverridesParser.create()
    flags = get_args_parser().parse_args(list(arguments))
    for argument in flags.overrides:
        if "=" not in argument and not argument.startswith("~"):
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
            _check_choice(key, override.get_value_string(), config_dir)
        if override.is_delete():
            raise ValueError(
                f"{argument}: an option cannot be removed; leave it out, or give it a value"
            )
    return flags


def _check_key(key: str, schema: type, config_dir: Path) -> None:
    options = dict(_options(schema))
    groups = [folder.name for folder in config_dir.iterdir() if folder.is_dir()]
    # Below an option that may hold anything (the optimiser's own arguments) every key is fine.
    parents = [".".join(key.split(".")[: n + 1]) for n in range(key.count("."))]
    if key in options or key in groups or any(options.get(parent) == "open" for parent in parents):
        return
    near = difflib.get_close_matches(key, [*options, *groups], n=1, cutoff=0.5)
    hint = (
        f"did you mean {near[0]}?" if near else "the options are " + ", ".join([*options, *groups])
    )
    raise ValueError(f"no such option: {key}; {hint}")


def _check_choice(group: str, value: str, config_dir: Path) -> None:
    """Refuse a preset that a config group does not have; sweeps name several, split by commas."""
    choices = sorted(file.stem for file in (config_dir / group).glob("*.yaml"))
    for choice in value.split(","):
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


def _help(name: str, schema: type, config_dir: Path, overrides: Sequence[str]) -> str:
    """What Hydra would answer to ``--help``, in half the time: it looks through its plugins first.

    The template is ``hydra.help.template`` of the script's YAML file.
    """
    from hydra import compose, initialize_config_dir
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf

    ConfigStore.instance().store(name=f"{name}_schema", node=schema)
    with initialize_config_dir(str(config_dir.resolve()), version_base="1.3"):
        composed = compose(name, list(overrides), return_hydra_config=True)
    own = OmegaConf.masked_copy(composed, [str(key) for key in composed if key != "hydra"])
    groups = {
        folder.name: ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
        for folder in sorted(config_dir.iterdir())
        if folder.is_dir()
    }
    return Template(composed.hydra.help.template).substitute(
        APP_CONFIG_GROUPS="".join(f"{group}: {names}\n" for group, names in groups.items()),
        CONFIG=OmegaConf.to_yaml(own),
    )


def _run_hydra(
    name: str,
    schema: type[Config],
    task: Callable[[Config], Result],
    config_dir: Path,
    exit_code: Callable[[Result], int],
    arguments: list[str],
) -> int:
    import hydra
    from hydra.core.config_store import ConfigStore
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import DictConfig, OmegaConf

    ConfigStore.instance().store(name=f"{name}_schema", node=schema)
    outcome: list[int | Exception] = []

    def job(composed: DictConfig) -> None:
        """One run: what Hydra calls, once, or once per combination of a sweep."""
        in_sweep = HydraConfig.get().mode is RunMode.MULTIRUN
        if in_sweep and "output_dir" in composed:
            composed.output_dir = HydraConfig.get().runtime.output_dir
        try:
            config = OmegaConf.to_object(composed)
            outcome.append(exit_code(task(config)))  # type: ignore[arg-type]
        except Exception as error:
            # Hydra would print a line of its own about a failed job; in a sweep it must know of it.
            if in_sweep or not is_user_error(error):
                raise
            outcome.append(error)

    decorate = hydra.main(
        version_base="1.3", config_path=str(config_dir.resolve()), config_name=name
    )
    with _hydra_raises(arguments):
        decorate(job)()
    for result in outcome:
        if isinstance(result, Exception):
            raise result
    return max((code for code in outcome if isinstance(code, int)), default=EXIT_OK)


@contextmanager
def _hydra_raises(arguments: list[str]) -> Iterator[None]:
    """Set what Hydra reads: ``sys.argv``, and HYDRA_FULL_ERROR=1 so that it raises errors."""
    saved_arguments, saved_environment = sys.argv, dict(os.environ)
    sys.argv = [sys.argv[0], *arguments]
    os.environ[FULL_ERROR] = "1"
    try:
        yield
    finally:
        sys.argv = saved_arguments
        if FULL_ERROR not in saved_environment:
            del os.environ[FULL_ERROR]
