"""A report as files: summary.json, report.md, report.html and its pictures, alike for every run."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skipnet.provenance import versions
from skipnet.storage import write_bytes, write_text
from skipnet.types import FloatArray, IntArray
from skipnet.viz import html
from skipnet.viz.tables import Table, markdown_text
from skipnet.viz.views import png_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skipnet.viz.dots import DotPicture

PEER_PACKAGES = ("kiss-matcher", "small_gicp")
PNG_COLOURS = 128


@dataclass(frozen=True)
class Dots:
    """Points in their colours."""

    points_m: FloatArray
    """(N, 3)."""
    colours: IntArray
    """(N, 3) uint8."""


@dataclass(frozen=True)
class ReportFigure:
    """A figure with the name of its file and what stands beneath it."""

    name: str
    caption: str
    figure: Figure | DotPicture
    view: str = ""
    """The same in 3-D, as HTML."""
    dots: Dots | None = None
    """The same for TensorBoard's mesh tab."""


@dataclass(frozen=True)
class Report:
    """What a run has to say."""

    title: str
    summary: dict[str, Any]
    """Content of summary.json: ``about`` (name to description), ``comparison`` (sentences) and
    ``versions`` stand in the report too."""
    tables: Sequence[Table]
    figures: Sequence[ReportFigure] = ()

    def write(self, folder: Path) -> dict[str, bytes]:
        """Write every file; the pictures come back by name."""
        pictures = {one.name: png_bytes(one.figure, colours=PNG_COLOURS) for one in self.figures}
        for name, png in pictures.items():
            write_bytes(folder / "figures" / f"{name}.png", png)
        text = json.dumps(self.summary, indent=1, allow_nan=False)
        write_text(folder / "summary.json", text + "\n")
        write_text(folder / "report.md", self.markdown())
        write_text(folder / "report.html", self.page(pictures))
        return pictures

    def markdown(self) -> str:
        """report.md; its pictures are the files in figures/."""
        about = [
            f"- {markdown_text(name)}: {markdown_text(value)}"
            for name, value in self.summary["about"].items()
        ]
        sentences = map(markdown_text, self.summary["comparison"])
        lines = [f"# {markdown_text(self.title)}", "", *about, "", *sentences, ""]
        lines += [table.markdown() for table in self.tables]
        for one in self.figures:
            caption = markdown_text(one.caption)
            lines += [f"![{caption}](figures/{one.name}.png)", "", caption, ""]
        return "\n".join([*lines, self._footer(), ""])

    def page(self, pictures: dict[str, bytes]) -> str:
        """report.html: one file that opens without anything beside it."""
        opened = [_html_table(table) for table in self.tables if not table.folded]
        folded = [_html_table(table) for table in self.tables if table.folded]
        shown = [html.picture(pictures[one.name], one.caption) + one.view for one in self.figures]
        return html.page(
            self.title,
            html.table(["", ""], list(self.summary["about"].items())),
            *[html.paragraph(sentence) for sentence in self.summary["comparison"]],
            *opened,
            *([html.section("Figures", *shown)] if shown else []),
            *folded,
            html.footer(self._footer()),
        )

    def _footer(self) -> str:
        return ", ".join(f"{name} {found}" for name, found in self.summary["versions"].items())


def run_versions() -> dict[str, str]:
    """Versions of all that has a say in the figures, peers and the machine included."""
    found = versions()
    for package in PEER_PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    found["machine"] = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
    return found


def _html_table(table: Table) -> str:
    content = html.table(table.headers, table.rows)
    note = html.paragraph(table.note) if table.note else ""
    if table.folded:
        return f"<details><summary>{escape(table.title)}</summary>{note}{content}</details>"
    return html.section(table.title, content, note)
