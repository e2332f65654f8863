"""How an option's range is checked."""

from __future__ import annotations


def require(condition: bool, option: str, value: object, expected: str) -> None:
    """Raise a ValueError that names the option, what was given and what is expected.

    >>> require(False, "seed", -1, "a whole number of at least 0")
    Traceback (most recent call last):
    ...
    ValueError: seed=-1: expected a whole number of at least 0
    """
    if not condition:
        raise ValueError(f"{option}={value}: expected {expected}")
