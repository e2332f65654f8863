"""What all commands share: a Hydra task whose user errors are one clear line, not a traceback.

Hydra composes ``configs/NAME.yaml`` with the overrides of the command line. Keys are checked
against the schema *before* that, because Hydra lets ``+key`` pass silently and answers a misspelt
one with a page.
"""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from skipnet.commands.composing import composed, help_text, is_plain, store
from skipnet.commands.errors import (
    EXIT_BAD_INPUT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    FULL_ERROR,
    is_user_error,
    one_line,
    was_interrupted,
)
from skipnet.commands.overrides import check_overrides
from skipnet.commands.sweeps import Rows, note_run, sweep_table
from skipnet.commands.words import as_typed, plain_options
from skipnet.progress import Terminal, say, shown
from skipnet.storage import owned, plain

CONFIG_DIR = Path(__file__).parents[1] / "configs"
"""The YAML files; each folder in it is a config group."""
Config = TypeVar("Config")
Result = TypeVar("Result")


def run(
    name: str,
    schema: type[Config],
    task: Callable[[Config], Result],
    exit_code: Callable[[Result], int] = lambda result: EXIT_OK,
    arguments: Sequence[str] | None = None,
    config_dir: Path = CONFIG_DIR,
    as_json: Callable[[Result], Any] = lambda result: result,
    as_rows: Callable[[Result], Rows] | None = None,
    has_no_presets: bool = False,
) -> int:
    """Run ``task`` on the configuration that the command line describes.

    Args:
        name: of the script; its Hydra config is ``config_dir/NAME.yaml``, which lists
            ``NAME_schema`` first in its defaults.
        schema: dataclass of the options; made anew from the composed values, so that its
            ``__post_init__`` checks the ranges.
        task: one library function behind a thin wrapper.
        exit_code: what the task's result means for the shell.
        arguments: overrides and Hydra flags; default: those of the process.
        config_dir: folder of the YAML files; its folders are config groups.
        as_json: what ``terminal=json`` prints of a result.
        as_rows: what the table of a sweep says of a result; None makes no table.
        has_no_presets: the YAML files leave all options as the schema has them. Then names of files
            and the like are put into it as they are, without Hydra, which takes 0.2 s.

    Returns:
        The exit code: 2 for bad input, after one line on stderr (an interrupt ends the process at
        once, with one line and exit code 130); otherwise ``exit_code(result)``,
        and the highest of them after a sweep (``--multirun``), whose runs get a folder each,
        numbered from 0, as their ``output_dir``.
    """
    arguments = as_typed(sys.argv[1:] if arguments is None else arguments, schema)
    try:
        options = plain_options(arguments, schema) if has_no_presets else None
        if options is not None:
            shown_task = _shown(name, task, as_json)
            return exit_code(_run_plainly(name, shown_task, schema(**options)))
        flags = check_overrides(arguments, schema, config_dir)
        if flags.help:
            print(help_text(name, schema, config_dir, flags.overrides))
            return EXIT_OK
        shown_task = _shown(name, task, as_json)
        if is_plain(flags):
            own, _ = composed(name, schema, config_dir, flags.overrides)
            return exit_code(_run_plainly(name, shown_task, _as_object(own)))
        return _run_hydra(name, schema, shown_task, config_dir, exit_code, arguments, as_rows)
    except (Exception, KeyboardInterrupt) as error:
        return _after(error, name)


def _after(error: BaseException, name: str) -> int:
    """The exit code after an error that is the user's, which is said; others are raised."""
    if was_interrupted(error):
        print(f"{name}: interrupted; what was written before is whole", file=sys.stderr)
        _end_now()
    if not is_user_error(error) or os.environ.get(FULL_ERROR) == "1":
        raise error
    print(f"{name.replace('/', ' ')}: {one_line(error)}", file=sys.stderr)
    return EXIT_BAD_INPUT


def _shown(
    name: str, task: Callable[[Config], Result], as_json: Callable[[Result], Any]
) -> Callable[[Config], Result]:
    """The task with a bar while it runs, or in silence, as the option ``terminal`` says."""

    def run_shown(config: Config) -> Result:
        """What the option says."""
        terminal = getattr(config, "terminal", Terminal.table)
        with shown(name.split("/")[-1], terminal), _warnings_said():
            result = task(config)
        if terminal is Terminal.json:
            print(json.dumps(plain(as_json(result)), allow_nan=False))
        return result

    return run_shown


class _Saying(logging.Handler):
    """Says on the terminal what is logged."""

    def emit(self, record: logging.LogRecord) -> None:
        """One line, above the bar."""
        say(record.getMessage())


@contextmanager
def _warnings_said() -> Iterator[None]:
    """Say the warnings of the package, which a program around it would find in its log."""
    logger, handler = logging.getLogger("skipnet"), _Saying(logging.WARNING)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING)  # Hydra has set the root's to errors alone
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(handler)


def _end_now() -> NoReturn:
    """End the process without waiting for its threads.

    Where numba was interrupted while it compiled, one of them may wait for ever for the lock of its
    compiler. Children end with their parent (``parallel.pools.end_with_parent``).
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(EXIT_INTERRUPTED)


def _run_plainly(name: str, task: Callable[[Config], Result], config: Config) -> Result:
    """One run without ``hydra.main``, which looks through its plugins and composes once more."""
    logging.getLogger().setLevel(logging.ERROR)  # as Hydra does where its logging is disabled
    with _owning(name, config):
        return task(config)


def _as_object(own: Any) -> Any:
    """The schema's dataclass of what Hydra composed."""
    from omegaconf import OmegaConf

    return OmegaConf.to_object(own)


def _run_hydra(
    name: str,
    schema: type[Config],
    task: Callable[[Config], Result],
    config_dir: Path,
    exit_code: Callable[[Result], int],
    arguments: list[str],
    as_rows: Callable[[Result], Rows] | None,
) -> int:
    import hydra
    from hydra.core.hydra_config import HydraConfig
    from hydra.types import RunMode
    from omegaconf import OmegaConf

    store(name, schema)
    outcome: list[int | Exception] = []
    sweeps: set[Path] = set()

    def job(given: Any) -> None:
        """One run: what Hydra calls, once, or once per combination of a sweep."""
        in_sweep = HydraConfig.get().mode is RunMode.MULTIRUN
        if in_sweep and "output_dir" in given:
            given.output_dir = HydraConfig.get().runtime.output_dir
        try:
            config = OmegaConf.to_object(given)
            with _owning(name, config):
                result = task(config)  # type: ignore[arg-type]
                outcome.append(exit_code(result))
            if in_sweep and as_rows is not None:
                folder = Path(given.output_dir)
                note_run(folder, HydraConfig.get().overrides.task, as_rows(result))
                sweeps.add(folder.parent)
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
    for folder in sweeps:
        print(sweep_table(folder))
    for result in outcome:
        if isinstance(result, Exception):
            raise result
    return max((code for code in outcome if isinstance(code, int)), default=EXIT_OK)


def _owning(name: str, config: object) -> AbstractContextManager[None]:
    """The folder of the run belongs to it, if it has one."""

    folder = getattr(config, "output_dir", None)
    return nullcontext() if folder is None else owned(Path(folder), name.replace("/", " "))


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
