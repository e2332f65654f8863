"""Reports as one HTML file that opens anywhere: styles inside, pictures as base64, nothing loaded.

Builders return HTML text and escape what they are given; ``page`` puts a head and a style around
them.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape
from string import Template

import numpy as np

from skipnet.types import FloatArray

_NUMBER = r"[-+]?\d[\d.,]*(e[-+]?\d+)? ?%?"
_NUMERIC = re.compile(
    rf"[-–]?|{_NUMBER}( (of|to) {_NUMBER})*( \({_NUMBER} of {_NUMBER}\))?|(nan|inf)"
)

_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 16px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1c1c1c; background: #fff;
       max-width: 62rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.5rem; margin: 0 0 1rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; padding-bottom: .2rem;
     border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
.wide { overflow-x: auto; }
th, td { padding: .3rem .9rem .3rem 0; text-align: left; vertical-align: top;
         border-bottom: 1px solid #eee; }
th { font-weight: 600; }
th:first-child { min-width: 13rem; }
td.number, th.number { text-align: right; }
td.number { white-space: nowrap; }
summary { font-size: 1.15rem; font-weight: 600; margin: 1.2rem 0 .4rem; cursor: pointer; }
.histogram { width: 100%; max-width: 40rem; }
figure { margin: 1rem 0; }
figure img { max-width: 100%; }
figcaption { color: #555; font-size: .9rem; }
pre { background: #f6f6f6; padding: .8rem 1rem; overflow-x: auto; font-size: .85rem; }
.status { border-left: .6rem solid; padding: .6rem 1.2rem; margin: 1rem 0 1.5rem;
          background: #f8f8f8; }
.status strong { display: block; font-size: 2.6rem; line-height: 1.15; }
.registered { border-color: #009e73; }
.ambiguous { border-color: #e69f00; }
.failed { border-color: #d55e00; }
footer { color: #777; font-size: .85rem; margin-top: 3rem; }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def page(title: str, *parts: str) -> str:
    """A whole document around parts that the other builders made."""
    return _PAGE.substitute(title=escape(title), body="\n".join(parts))


def section(heading: str, *parts: str) -> str:
    """A heading and what stands beneath it."""
    return f"<h2>{escape(heading)}</h2>\n" + "\n".join(parts)


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{escape(text)}</p>"


def preformatted(text: str) -> str:
    """Text whose line breaks and columns stay."""
    return f"<pre>{escape(text)}</pre>"


def table(headers: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; columns that hold only numbers, such as 0.5, 3 of 4 or 50 % to 60 %, are set flush
    right. Floats come formatted, as text.

    Empty headers throughout leave the head out.
    """
    is_number = [all(_looks_numeric(row[index]) for row in rows) for index in range(len(headers))]
    kinds = [' class="number"' if number else "" for number in is_number]
    head = "".join(
        f"<th{kind}>{_breakable(name)}</th>" for name, kind in zip(headers, kinds, strict=True)
    )
    head = f"<tr>{head}</tr>" if any(headers) else ""
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{kind}>{escape(str(cell))}</td>" for cell, kind in zip(row, kinds, strict=True)
        )
        + "</tr>\n"
        for row in rows
    )
    return f'<div class="wide"><table>\n{head}\n{body}</table></div>'


def picture(png: bytes, caption: str) -> str:
    """A PNG inside the page."""
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def status_banner(status: str, reason: str, confidence: float | None = None) -> str:
    """The outcome in big letters, with its reason and perhaps its confidence in [0, 1]."""
    meaning = "the share of results like this one that are right"
    line = "" if confidence is None else f"<br>Confidence {confidence:.0%}: {meaning}."
    heading = f"<strong>{escape(status)}</strong>"
    return f'<div class="status {escape(status)}">{heading}{escape(reason)}{line}</div>'


def matrix(T_a_b: FloatArray) -> str:
    """A (4, 4) transform in a form that can be copied."""
    return preformatted(
        np.array2string(np.asarray(T_a_b), precision=9, suppress_small=True, floatmode="fixed")
    )


def bullets(lines: Sequence[str]) -> str:
    """A list of sentences."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def histogram(values: FloatArray, most: float, unit: str, bins: int = 60) -> str:
    """How often values from 0 to ``most`` occur, as a drawing; the last bar holds all above."""
    counts, _ = np.histogram(np.minimum(values, most), bins, (0, most))
    highest = max(int(counts.max()), 1)
    bars = "".join(
        f'<rect x="{10 * number}" y="{100 - 100 * count / highest:.2f}" width="9" '
        f'height="{100 * count / highest:.2f}"/>'
        for number, count in enumerate(counts)
    )
    ends = (
        f'<text x="0" y="114">0</text><text x="{10 * bins}" y="114" text-anchor="end">'
        f"{most:.3g} {escape(unit)} and more</text>"
    )
    return (
        f'<svg class="histogram" viewBox="0 0 {10 * bins} 118" role="img" '
        f'aria-label="histogram"><g fill="#0072b2">{bars}</g><g font-size="11">{ends}</g></svg>'
    )


def footer(text: str) -> str:
    """Small print at the end."""
    return f"<footer>{escape(text)}</footer>"


def _breakable(name: str) -> str:
    """A heading whose long names may break after an underscore, so that columns stay narrow."""
    return escape(name).replace("_", "_<wbr>")


def _looks_numeric(cell: object) -> bool:
    return _NUMERIC.fullmatch(str(cell)) is not None
