"""What stands above the lines of numbers: a count, names of columns, units, other words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from skipnet.clouds.formats.columns import find_axes, unit_in, unit_word
from skipnet.clouds.formats.text_lines import is_number, pieces

_LONGEST_HEAD = 100
"""Lines, beside comments."""
_GENERIC = re.compile(r"(col(umn)?|field|var|v|c|f)?[ _.]?\d+|", re.IGNORECASE)
"""What programs call columns that have no names."""
_DEGREES = re.compile(r"(lon|lat)(gitude|itude)?\b|(longitude|latitude)_", re.IGNORECASE)


class Lines:
    """Lines that can be looked at before they are taken."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines
        self._seen: list[str] = []

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        return self._seen.pop(0) if self._seen else next(self._lines)

    def peek(self, count: int) -> list[str]:
        """The next lines, at most so many, which stay."""
        self._seen += islice(self._lines, max(0, count - len(self._seen)))
        return self._seen[:count]


@dataclass
class Head:
    """What is said above a block of points."""

    count: int | None = None
    """Of points."""
    names: list[str] | None = None
    unit: str = "auto"
    notes: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list)
    """Comments above the points."""


def read_head(lines: Lines, remarks: list[str], path: Path) -> Head:
    """Take the lines above the first point.

    Raises:
        ValueError: no points follow, or a line names columns and none of them is x, y or z.
    """
    head = Head(remarks=remarks)
    above: list[str] = []
    while (coming := lines.peek(3)) and not _begins_points(coming):
        line = next(lines)
        if head.count is None and re.fullmatch(r"\s*\d{1,18}\s*", line):
            head.count = int(line)
        elif len(above) < _LONGEST_HEAD:
            above.append(line)
        else:
            raise _no_points(above, path)
    if not lines.peek(1):
        if above and not any(find_axes(header_words(line)) for line in above):
            raise _no_points(above, path)
        raise ValueError(f"{path}: holds no points")
    width = len(pieces(lines.peek(1)[0]))
    _find_names(head, above, width, path)
    units = [unit for remark in [*remarks, *above] if (unit := unit_in(remark))]
    head.unit = units[0] if units else "auto"
    return head


def _no_points(above: Sequence[str], path: Path) -> ValueError:
    if any(is_number(word) for line in above for word in pieces(line)):
        return ValueError(f"{path}: expected lines of at least three numbers x y z")
    words = " ".join(header_words(above[0]))[:60]
    return ValueError(
        f"{path}: not a point file: a line holds neither numbers nor x, y, z: {words!r}"
    )


def _begins_points(coming: Sequence[str]) -> bool:
    """Whether the first of some lines is a point: three numbers, and laid out like its next."""
    rows = [pieces(line) for line in coming]
    if sum(is_number(word) or word.lower() == "nan" for word in rows[0]) < 3:
        return False
    if len(rows) > 1 and _counts_columns(rows[0]) and not _counts_columns(rows[1]):
        return False
    widths = [len(row) for row in rows]
    return len(rows) < 3 or widths[1] == widths[0] or widths[2] != widths[1]


def _counts_columns(words: Sequence[str]) -> bool:
    """Whether a line is 0, 1, 2, ...: what tables of data frames have for names."""
    counted = [word for word in words if is_number(word)]
    return counted == [str(number) for number in range(len(counted))]


def _find_names(head: Head, above: Sequence[str], width: int, path: Path) -> None:
    """The columns' names from the lines above, or from the last comment that names x, y, z."""
    named = [number for number, line in enumerate(above) if find_axes(header_words(line))]
    if named:
        at = named[-1]
        units = header_words(above[at + 1]) if at + 1 < len(above) else []
        head.names = _with_units(header_words(above[at]), units)
        left = [line for number, line in enumerate(above) if number not in (at, at + 1)]
    else:
        _refuse_other_names(above, width, path)
        comments = [header_words(remark) for remark in head.remarks]
        complete = [names for names in comments if len(names) == width]
        fitting = [names for names in complete if find_axes(names)]
        if not fitting and (foreign := [names for names in complete if _name_degrees(names)]):
            raise _other_names(foreign[0], path)
        head.names, left = (fitting[-1] if fitting else None), list(above)
    if left:
        words = " ".join(left[0].split())[:40]
        count = "a line" if len(left) == 1 else f"{len(left)} lines"
        head.notes = (f"left out {count} above the points, such as {words!r}",)


def _with_units(names: list[str], units: Sequence[str]) -> list[str]:
    """Names with the units that a line of its own gives them."""
    known = [unit_word(unit) for unit in units]
    if len(known) != len(names) or not any(known):
        return names
    return [f"{name} ({unit})" if unit else name for name, unit in zip(names, known, strict=True)]


def _refuse_other_names(above: Sequence[str], width: int, path: Path) -> None:
    words = header_words(above[-1]) if above else []
    if any(word.lower() == "ncols" for line in above for word in line.split()):
        raise ValueError(f"{path}: is a grid of heights, not lines of x y z")
    if len(words) != width or any(map(is_number, words)) or all(map(_GENERIC.fullmatch, words)):
        return
    raise _other_names(words, path)


def _other_names(words: Sequence[str], path: Path) -> ValueError:
    hint = "; project degrees to metres first" if _name_degrees(words) else ""
    return ValueError(
        f"{path}: not a point file: a line holds neither numbers nor x, y, z: "
        f"{' '.join(words)[:60]!r}{hint}"
    )


def _name_degrees(words: Sequence[str]) -> bool:
    """Whether some columns are called longitude and latitude, whatever of."""
    return any(_DEGREES.match(word) for word in words)


def header_words(line: str) -> list[str]:
    """The names in a header; a unit in brackets belongs to the word before it."""
    line = re.sub(r"\s+(?=[\[(<])", "", line.strip().lstrip("#/%!; "))
    delimiter = next((mark for mark in ";|,\t" if mark in line), None)
    return [word.strip(" \"'") for word in line.split(delimiter)]
