"""Text files: a point per line, with or without a header, a count or names of columns."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import cloud_of_columns, find_axes
from skipnet.clouds.formats.unnamed import name_columns

LINES_AT_ONCE = 1 << 18
"""Lines parsed in one go."""
_LOOKED_AT_BYTES = 1 << 16
_LONGEST_LINE = 1 << 16
_COMMENTS = ("#", "//", "%", "!")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


@dataclass(frozen=True)
class _Layout:
    """How the lines of a file are to be taken apart."""

    delimiter: str | None
    """None: blanks."""
    decimal_comma: bool
    numeric: list[int]
    """The columns that hold numbers."""
    width: int
    """Of all columns."""


def read_text(path: Path) -> Iterator[Cloud]:
    """Columns split by blanks, commas or semicolons; a header may say which are x, y, z.

    A first line of one whole number is the number of points (PTS); another block of points may
    follow, with its own number.

    Raises:
        ValueError: it is not text, has lines that are no points, fewer than it announces, or
            columns that cannot be x, y, z.
    """
    with open(path, encoding=_encoding(path), errors="replace") as file:
        lines = _content(file, path)
        first = next(lines, None)
        if first is None:
            raise ValueError(f"{path}: holds no points")
        while first is not None:
            count = int(first) if re.fullmatch(r"\s*\d{1,18}\s*", first) else None
            if count is not None and count > path.stat().st_size:
                raise ValueError(f"{path}: truncated: it announces {count} points")
            rows = lines if count is not None else chain([first], lines)
            yield from _block(islice(rows, count), count, path)
            first = next(lines, None)


def _encoding(path: Path) -> str:
    """UTF-8 or UTF-16 by their marks, UTF-8 where it can be, else Latin-1."""
    with open(path, "rb") as file:
        head = file.read(_LOOKED_AT_BYTES)
    marked = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if marked and len(head) % 2 == 0 and head.count(b"\0") > len(head) // 3:
        return "utf-16"
    if re.search(rb"[\x00-\x08\x0e-\x1f]", head):
        raise ValueError(f"{path}: not a text file: expected lines of x y z")
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def _content(file: Iterator[str], path: Path) -> Iterator[str]:
    """Lines that hold something; of comments the one that names the columns of the first line."""
    header: str | None = None
    before_data = True
    for line in file:
        words = line.strip()
        if not words:
            continue
        if len(words) > _LONGEST_LINE:
            raise ValueError(f"{path}: not a point file: a line is {len(words)} letters long")
        if words.startswith(_COMMENTS):
            names = _header_words(words)
            header = words.lstrip("#/%! ") if before_data and find_axes(names) else header
            continue
        if before_data and len(_words_of(words)) > 1:
            before_data = False
            if header and len(_header_words(header)) == len(_words_of(words)):
                yield header
        yield line


def _block(rows: Iterator[str], count: int | None, path: Path) -> Iterator[Cloud]:
    """A header, if there is one, and the points below it."""
    names, first = None, next(rows, None)
    while first is not None and not any(map(_is_number, _words_of(first))):
        names, first = _header_words(first), next(rows, None)
        if not find_axes(names):
            raise ValueError(
                f"{path}: not a point file: a line holds neither numbers nor x, y, z: "
                f"{' '.join(names)[:60]!r}"
            )
    if first is None:
        raise ValueError(f"{path}: holds no points")
    layout, present = _layout(first), 0
    notes: tuple[str, ...] = ()
    rows = chain([first], rows)
    while lines := list(islice(rows, LINES_AT_ONCE)):
        table = _parse(lines, layout, path)
        present += len(table)
        if names is None:
            names, notes = name_columns(table, path)
        yield _cloud(table, names, layout, notes, path)
    if count is not None and present != count:
        raise ValueError(f"{path}: truncated: it announces {count} points and holds {present}")


def _cloud(
    table: np.ndarray, names: list[str], layout: _Layout, notes: tuple[str, ...], path: Path
) -> Cloud:
    if len(names) == layout.width:  # a header also names the columns of words
        names = [names[column] for column in layout.numeric]
    if len(names) != table.shape[1]:
        raise ValueError(
            f"{path}: its header names {len(names)} columns, its lines have {layout.width}"
        )
    columns = dict(zip(names, table.T, strict=True))
    if len(columns) < len(names):
        raise ValueError(f"{path}: two columns of one name: {' '.join(names)[:80]}")
    left_out = layout.width - len(layout.numeric)
    if left_out:
        notes = (*notes, f"{left_out} columns of words left out")
    return cloud_of_columns(columns, path, notes=notes)


def _words_of(line: str) -> list[str]:
    return [word.strip(' "') for word in re.split(r"[\s;,]+", line.strip())]


def _header_words(line: str) -> list[str]:
    """The names in a header; a unit in brackets belongs to the word before it."""
    line = re.sub(r"\s+(?=[\[(<])", "", line.strip().lstrip("#/%! "))
    delimiter = next((mark for mark in ";,\t" if mark in line), None)
    return [word.strip(" \"'") for word in line.split(delimiter)]


def _layout(line: str) -> _Layout:
    delimiter, decimal_comma = _delimiter(line)
    words = line.strip().split(delimiter)
    if len(words) > 1 and not words[-1].strip():
        words.pop()  # a line may end with its delimiter
    numeric = [
        column
        for column, word in enumerate(words)
        if _is_number(word.replace(",", ".") if decimal_comma else word)
    ]
    return _Layout(delimiter, decimal_comma, numeric, len(words))


def _delimiter(line: str) -> tuple[str | None, bool]:
    """What stands between the columns, and whether numbers have decimal commas."""
    if ";" in line:
        return ";", "," in line
    words = line.split()
    commas = [word for word in words if "," in word]
    if commas and len(words) >= 3 and all(_DECIMAL_COMMA.fullmatch(word) for word in commas):
        return None, True
    return ("," if commas else None), False


def _parse(lines: list[str], layout: _Layout, path: Path) -> np.ndarray:
    if len(layout.numeric) < 3:
        raise ValueError(f"{path}: expected lines of at least three numbers x y z")
    if layout.decimal_comma:
        lines = [line.replace(",", ".") for line in lines]
    if len(lines[-1].strip().rstrip(layout.delimiter).split(layout.delimiter)) != layout.width:
        raise ValueError(
            f"{path}: expected lines of at least three numbers x y z, {layout.width} columns in "
            "each: one ends too early or too late"
        )
    # Reading every column, not only three, lets NumPy notice a line that is too short or too long.
    columns = layout.numeric if len(layout.numeric) < layout.width else None
    if columns is None and lines[0].rstrip().endswith(layout.delimiter or "\0"):
        columns = layout.numeric
    try:
        return np.loadtxt(
            lines, delimiter=layout.delimiter, usecols=columns, ndmin=2, comments=None,
            quotechar='"',
        )  # fmt: skip
    except (ValueError, IndexError) as error:
        message = " ".join(str(error).split(";")[0].split())[:120]
        raise ValueError(
            f"{path}: expected lines of at least three numbers x y z: {message}"
        ) from error


def _is_number(word: str) -> bool:
    try:
        float(word.strip(' "'))
    except ValueError:
        return bool(_DECIMAL_COMMA.fullmatch(word.strip(' "')))
    return True
