"""Text files: a point per line, with or without a header."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skipnet.types import FloatArray


def read_text(path: Path) -> FloatArray:
    """Columns split by blanks, commas or semicolons; a header may say which are x, y, z."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file: expected lines of x y z") from error
    rows = [line for line in lines if line.strip() and not line.lstrip().startswith(("#", "//"))]
    if not rows:
        raise ValueError(f"{path}: holds no points")
    delimiter = next((mark for mark in ";," if mark in rows[0]), None)
    columns = [0, 1, 2]
    if not _is_number(rows[0].split(delimiter)[0]):
        columns = _header_columns(
            [word.strip(' "').lower() for word in rows[0].split(delimiter)], path
        )
        rows = rows[1:]
    try:
        # Reading every column, not only three, lets NumPy notice a last line that was cut short.
        table = np.loadtxt(rows, delimiter=delimiter, ndmin=2) if rows else np.empty((0, 3))
        return table[:, columns]
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"{path}: expected lines of at least three numbers x y z: {error}"
        ) from error


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _header_columns(names: list[str], path: Path) -> list[int]:
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(
            f"{path}: not a point file: its first line holds neither numbers nor x, y, z"
        )
    return [names.index(axis) for axis in "xyz"]
