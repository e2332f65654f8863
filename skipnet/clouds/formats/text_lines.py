"""Lines of numbers taken apart: what parts the columns, marks decimals, stands for nothing."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skipnet.types import FloatArray

_DECIMAL_COMMA = re.compile(r"[-+]?[\d.]*\d,\d+([eE][-+]?\d+)?")
_FORTRAN = re.compile(r"([-+]?[\d.]+)[dD]([-+]?\d{1,3})")
_QUOTED = re.compile(r'"[^"]*"')
_MISSING = ("", "-", "--", "na", "n/a", "#n/a", "null", "none", "nil", "nan", "?")
"""What programs write for a number that is not there."""


@dataclass(frozen=True)
class Layout:
    """How the lines of a file are to be taken apart."""

    delimiter: str | None
    """None: blanks."""
    decimal_comma: bool
    numeric: list[int]
    """The columns that hold numbers."""
    width: int
    """Of all columns."""


def split(line: str, delimiter: str | None) -> list[str]:
    """The words of a line; what stands in quotes is one word."""
    if delimiter is None:
        return [word.strip('"') for word in line.split()]
    line = line.strip(" \r\n")
    if '"' in line:
        words = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    else:
        words = line.split(delimiter)
    return [word.strip() for word in words]


def pieces(line: str) -> list[str]:
    """The words of a line of which nothing is known yet."""
    marks = [mark for mark in ";|\t," if mark in _QUOTED.sub("", line)]
    if marks and marks[0] != ",":
        return split(line, marks[0])
    words = line.split()
    if marks and not (len(words) >= 3 and _all_decimal_commas(words)):
        return split(line, ",")
    return split(line, None)


def to_number(word: str, decimal_comma: bool = False) -> float:
    """A word as a number; NaN for what stands for none.

    Raises:
        ValueError: it is neither.

    >>> to_number("1.234,5", decimal_comma=True), to_number("2.5D+01"), to_number("--")
    (1234.5, 25.0, nan)
    """
    word = word.strip(' "')
    if word.lower() in _MISSING:
        return float("nan")
    if decimal_comma and "," in word:
        word = word.replace(".", "").replace(",", ".")
    if "_" in word:
        raise ValueError(f"could not convert string {word[:40]!r} to a number")
    return float(_FORTRAN.sub(r"\1e\2", word))


def is_number(word: str) -> bool:
    """Whether a word is a number, with a point or a comma."""
    word = word.strip(' "')
    if word.lower() in _MISSING:
        return False
    try:
        to_number(word)
    except ValueError:
        return bool(_DECIMAL_COMMA.fullmatch(word))
    return True


def find_layout(sample: Sequence[str]) -> Layout:
    """The layout of lines, of which the first few are looked at together."""
    delimiter, decimal_comma = _delimiter(sample)
    rows = [split(line, delimiter) for line in sample]
    if delimiter is not None and all(len(row) > 1 and not row[-1] for row in rows):
        rows = [row[:-1] for row in rows]  # every line ends with its delimiter
    width = max(len(row) for row in rows)
    numeric = [
        column
        for column in range(width)
        if _holds_numbers([row[column] for row in rows if column < len(row)], decimal_comma)
    ]
    return Layout(delimiter, decimal_comma, numeric, width)


def _holds_numbers(words: Sequence[str], decimal_comma: bool) -> bool:
    present = [word for word in words if word.strip(' "').lower() not in _MISSING]
    try:
        return bool([to_number(word, decimal_comma) for word in present])
    except ValueError:
        return False


def _delimiter(sample: Sequence[str]) -> tuple[str | None, bool]:
    """What stands between the columns, and whether numbers have decimal commas."""
    masked = [_QUOTED.sub("q", line.strip(" \r\n")) for line in sample]
    for mark in ";|\t":
        if all(mark in line for line in masked):
            rows = [split(line, mark) for line in sample]
            if mark == "\t" and any(len(word.split()) > 2 for row in rows for word in row):
                continue
            return mark, any(_DECIMAL_COMMA.fullmatch(word) for row in rows for word in row)
    words = [line.split() for line in masked]
    if all(len(row) >= 3 and _all_decimal_commas(row, some=False) for row in words):
        return None, any("," in word for row in words for word in row)
    if all("," in line for line in masked):
        quoted = [word for line in sample for word in split(line, ",") if "," in word]
        return ",", bool(quoted) and all(_DECIMAL_COMMA.fullmatch(word) for word in quoted)
    return None, False


def _all_decimal_commas(words: Sequence[str], some: bool = True) -> bool:
    commas = [word for word in words if "," in word]
    return (bool(commas) or not some) and all(_DECIMAL_COMMA.fullmatch(word) for word in commas)


def parse(lines: list[str], layout: Layout, path: Path) -> FloatArray:
    """(N, k) the numbers of lines; NaN where one is missing.

    Raises:
        ValueError: a line has another number of columns, or words among its numbers.
    """
    if len(layout.numeric) < 3:
        raise ValueError(f"{path}: expected lines of at least three numbers x y z")
    if not _is_whole(split(lines[-1], layout.delimiter), layout):
        raise ValueError(
            f"{path}: expected lines of at least three numbers x y z, {layout.width} columns in "
            "each: one ends too early or too late"
        )
    text = [line.replace(",", ".") for line in lines] if layout.decimal_comma else lines
    # Reading every column, not only three, lets NumPy notice a line that is too short or too long.
    columns = layout.numeric if len(layout.numeric) < layout.width else None
    if columns is None and lines[0].rstrip().endswith(layout.delimiter or "\0"):
        columns = layout.numeric
    try:
        if layout.decimal_comma and layout.delimiter == ",":
            raise ValueError("its commas mean two things")
        return np.loadtxt(
            text, delimiter=layout.delimiter, usecols=columns, ndmin=2, comments=None,
            quotechar='"',
        )  # fmt: skip
    except (ValueError, IndexError):
        return _one_by_one(lines, layout, path)


def _one_by_one(lines: Sequence[str], layout: Layout, path: Path) -> FloatArray:
    """As ``parse``, for numbers that NumPy does not know: missing, of Fortran, in thousands."""
    table = np.empty((len(lines), len(layout.numeric)))
    for row, line in enumerate(lines):
        words = split(line, layout.delimiter)
        try:
            if not _is_whole(words, layout):
                raise ValueError(f"{len(words)} columns instead of {layout.width}")
            table[row] = [to_number(words[k], layout.decimal_comma) for k in layout.numeric]
        except ValueError as error:
            message = " ".join(str(error).split())[:120]
            raise ValueError(
                f"{path}: expected lines of at least three numbers x y z: row {row}: {message}"
            ) from error
    return table


def _is_whole(words: Sequence[str], layout: Layout) -> bool:
    ends = len(words) == layout.width + 1 and not words[-1] and layout.delimiter is not None
    return len(words) == layout.width or ends
