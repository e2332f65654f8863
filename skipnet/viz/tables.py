"""Tables for Markdown and for pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

NOTHING = "–"


@dataclass(frozen=True)
class Table:
    """A titled table; the first column names the rows, the others are set flush right."""

    title: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    folded: bool = False
    """Long tables stay closed in HTML until they are asked for."""

    def markdown(self) -> str:
        """The table in GitHub's Markdown, title and note included."""
        lines = [f"## {markdown_text(self.title)}", "", _line(self.headers)]
        lines.append(_line(("---",) + ("---:",) * (len(self.headers) - 1)))
        lines += [_line(row) for row in self.rows]
        note = markdown_text(self.note)
        return "\n".join([*lines, "", note, ""] if note else [*lines, ""])


def number(value: float | None) -> str:
    """Three significant digits, without an exponent; a dash for what is missing or infinite.

    >>> [number(value) for value in (635.9887, 8.642, 0.085791, 0.00012, 0.0, None)]
    ['636', '8.64', '0.0858', '0.00012', '0', '–']
    """
    if value is None or abs(value) == float("inf"):
        return NOTHING
    if value == 0:
        return "0"
    digits = max(0, 2 - int(f"{value:e}".split("e")[1]))
    text = f"{value:.{min(digits, 5)}f}"
    return text.rstrip("0").rstrip(".") if "." in text and digits > 3 else text


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(map(markdown_text, cells)) + " |"


def markdown_text(text: str) -> str:
    """Any text on one line of Markdown, as itself: names of files and reasons come from anywhere.

    >>> markdown_text("a|b <script> [x](y)")
    'a\\\\|b &lt;script> \\\\[x](y)'
    """
    for mark in "\\`|*[":
        text = text.replace(mark, f"\\{mark}")
    return " ".join(text.replace("<", "&lt;").split())
