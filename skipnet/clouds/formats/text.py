"""Text files of points, with or without a header: XYZ, TXT, CSV, ASC, PTS."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import cloud_of_columns
from skipnet.clouds.formats.text_head import Head, Lines, read_head
from skipnet.clouds.formats.text_lines import Layout, find_layout, parse, pieces
from skipnet.clouds.formats.unnamed import name_columns

LINES_AT_ONCE = 1 << 18
"""Lines parsed in one go."""
_LOOKED_AT_BYTES = 1 << 16
_LOOKED_AT_LINES = 20
_LONGEST_LINE = 1 << 16
_MOST_REMARKS = 100
_COMMENTS = ("#", "//", "%", "!")


def read_text(path: Path) -> Iterator[Cloud]:
    """Columns split by blanks, commas, semicolons, bars or tabs; a header may name x, y, z.

    A first line of one whole number is the number of points (PTS); another block of points may
    follow, with its own number.

    Raises:
        ValueError: it is not text, has lines that are no points, fewer than it announces, or
            columns that cannot be x, y, z.
    """
    with open(path, encoding=_encoding(path), errors="replace") as file:
        remarks: list[str] = []
        lines = Lines(_content(file, remarks, path))
        if not lines.peek(1):
            raise ValueError(f"{path}: holds no points")
        while lines.peek(1):
            head = read_head(lines, remarks, path)
            if head.count is not None and head.count > path.stat().st_size:
                raise ValueError(f"{path}: truncated: it announces {head.count} points")
            yield from _block(lines, head, path)


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


def _content(file: Iterator[str], remarks: list[str], path: Path) -> Iterator[str]:
    """Lines that hold something; comments above the first of two words and more are remarks."""
    above = True
    for line in file:
        words = line.strip()
        if not words:
            continue
        if len(words) > _LONGEST_LINE:
            raise ValueError(f"{path}: not a point file: a line is {len(words)} letters long")
        is_remark = words.startswith(_COMMENTS) or (above and words.startswith((";", "--")))
        if not is_remark:
            above = above and len(pieces(line)) < 2
            yield line
        elif above and len(remarks) < _MOST_REMARKS:
            remarks.append(words)


def _block(lines: Lines, head: Head, path: Path) -> Iterator[Cloud]:
    """The points below a head, as many as it announces, else all."""
    sample = lines.peek(min(_LOOKED_AT_LINES, head.count or _LOOKED_AT_LINES))
    layout, names, notes, present = find_layout(sample), head.names, head.notes, 0
    rows = islice(lines, head.count)
    while some := list(islice(rows, LINES_AT_ONCE)):
        table = parse(some, layout, path)
        present += len(table)
        if names is None:
            is_pts = head.count is not None or path.suffix.lower() == ".pts"
            names, taken = name_columns(table, path, is_pts)
            notes = (*notes, *taken)
        yield _cloud(table, names, layout, notes, head.unit, path)
    if head.count is not None and present != head.count:
        raise ValueError(f"{path}: truncated: it announces {head.count} points, holds {present}")


def _cloud(
    table: np.ndarray,
    names: list[str],
    layout: Layout,
    notes: tuple[str, ...],
    unit: str,
    path: Path,
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
        several = "a column" if left_out == 1 else f"{left_out} columns"
        notes = (*notes, f"{several} of words left out")
    return cloud_of_columns(columns, path, unit, notes=notes)
