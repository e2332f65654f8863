"""What is checked before any work is done: ranges, names, packages."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from difflib import get_close_matches
from numbers import Integral
from pathlib import Path
from types import ModuleType
from typing import Any

METRES_PER_UNIT = {
    **{"m": 1.0, "mm": 0.001, "cm": 0.01, "km": 1000.0},
    **{"ft": 0.3048, "in": 0.0254, "us_ft": 1200 / 3937},
}
"""The units of length that files may be in."""


def require(condition: bool, option: str, value: object, expected: str) -> None:
    """Raise a ValueError that names the option, what was given and what is expected.

    >>> require(False, "seed", -1, "a whole number of at least 0")
    Traceback (most recent call last):
    ...
    ValueError: seed=-1: expected a whole number of at least 0
    """
    if not condition:
        raise ValueError(f"{option}={value}: expected {expected}")


def check_seed(seed: object) -> None:
    """Refuse what names no one sequence of random numbers, as None would."""
    is_whole = isinstance(seed, Integral) and not isinstance(seed, bool)
    require(is_whole and seed >= 0, "seed", seed, "a whole number of at least 0")  # type: ignore[operator]


def find_object(option: str, path: str) -> Any:
    """What a dotted path leads to, a function or a class of any package that can be imported; or
    FILE.py:NAME, of a file anywhere.

    >>> find_object("make", "math.hypot")(3, 4)
    5.0
    """
    module, _, name = path.rpartition(".")
    if ".py:" in path:
        return _of_file(option, path)
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{option}={path}: expected package.module.name ({error})") from error


def _of_file(option: str, path: str) -> Any:
    """What a file of Python calls by a name."""
    file, _, name = path.rpartition(":")
    if not Path(file).is_file():
        raise FileNotFoundError(f"{file}: no such file, for {option}={path}")
    # Known by its whole path, lest it stand for another module that is called like the file.
    known_as = f"{Path(file).stem} of {Path(file).resolve().parent}"
    specification = importlib.util.spec_from_file_location(known_as, file)
    if specification is None or specification.loader is None:
        raise ValueError(f"{option}={path}: expected FILE.py:NAME")
    module = importlib.util.module_from_spec(specification)
    sys.modules[known_as] = module  # so that what it makes can be sent to other processes
    specification.loader.exec_module(module)
    if not hasattr(module, name):
        raise ValueError(f"{option}={path}: {file} has no {name}")
    return getattr(module, name)


def as_path(given: object, what: str) -> Path:
    """A path of what names one.

    Raises:
        ValueError: something else was given.
    """
    if not isinstance(given, str | bytes | os.PathLike):
        raise ValueError(f"{what}={given!r}: expected a path")
    return Path(os.fsdecode(given))


def check_known(option: str, given: str, known: tuple[str, ...]) -> None:
    """Raise a ValueError with the nearest choice for one that does not exist."""
    if given not in known:
        near = get_close_matches(str(given), known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"{option}={given}: {hint}expected one of {', '.join(known)}")


def require_package(package: str, pip_name: str) -> ModuleType:
    """Import an optional package, or stop with the command that installs it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise ImportError(
            f"this method needs the package {package} ({error}); "
            f"install it with: pip install {pip_name}"
        ) from error


def missing_package(path: Path, package: str) -> ModuleNotFoundError:
    """The error for a format whose optional package is not installed."""
    return ModuleNotFoundError(
        f"{path}: reading {path.suffix} needs the package {package}: pip install 'skipnet[formats]'"
    )


def check_viewpoint(option: str, value: object) -> None:
    """A viewpoint is "auto", None (unknown), or the sensor's position [x, y, z] in metres."""
    is_position = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(number, int | float) for number in value)
    )
    require(value is None or value == "auto" or is_position, option, value, "auto, null or [x,y,z]")


def suggestion(given: str, known: tuple[str, ...]) -> str:
    """The end of an error message: the name that may have been meant, and all names there are."""
    close = get_close_matches(given, known, n=1)
    meant = f"did you mean {close[0]!r}? " if close else ""
    return f"; {meant}expected one of {', '.join(known)}"
