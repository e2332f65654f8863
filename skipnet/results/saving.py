"""What results in memory do when they are asked to save, show or draw themselves."""

from __future__ import annotations

import os
import tempfile
from html import escape
from pathlib import Path

from skipnet.checks import as_path
from skipnet.projects.assembly import Assembly
from skipnet.registration.result import Registration
from skipnet.results.clouds import output_names
from skipnet.results.files import Choices, write_pair
from skipnet.results.folder import new_results
from skipnet.results.group_views import group_viewer
from skipnet.results.inputs import Given, given_cloud
from skipnet.results.many import write_many
from skipnet.results.views import pair_viewer
from skipnet.scans.given import opened
from skipnet.viz import html
from skipnet.viz.lengths import Lengths

_NOTEBOOK_POINTS = 40_000
"""Shown in a notebook, which keeps every picture in its file."""


def save(result: Registration, folder: str | os.PathLike[str], format: str) -> None:
    """See ``Registration.save``."""
    source, target = _scans(result)
    names = output_names("aligned", [source.path], format)
    seed = result.given.seed if result.given is not None else 0
    with new_results(as_path(folder, "folder")) as unfinished:
        write_pair(source, target, result, unfinished, names, seed)


def save_many(result: Assembly, folder: str | os.PathLike[str], format: str) -> None:
    """See ``Assembly.save``."""
    scans = [_scan_of(result, number) for number in range(len(result.given))]
    names = output_names("merged", [scan.path for scan in scans], format)
    with new_results(as_path(folder, "folder")) as unfinished:
        write_many(scans, result, unfinished, names, Choices())


def _scan_of(result: Assembly, number: int) -> Given:
    """One of many scans, read again where a path was given."""
    name = f"scan {number}"
    return given_cloud(opened(result.given[number], name), name)


def show(result: Registration | Assembly) -> str:
    """See ``Registration.show``."""
    import webbrowser

    folder = Path(tempfile.mkdtemp(prefix="skipnet."))
    result.save(folder)
    page = folder / "report.html"
    webbrowser.open(page.as_uri())
    return str(page)


def notebook_html(result: Registration) -> str:
    """The verdict, and both scans in a frame of their own, where the result holds them."""
    banner = html.status_banner(result.status, result.reason, result.confidence)
    if result.given is None:
        return banner
    source, target = _scans(result)
    lengths = Lengths(target.cloud.unit)
    view, _ = pair_viewer(source, target, result, lengths, _NOTEBOOK_POINTS)
    return _framed(html.page("Registration of two scans", banner, view))


def notebook_html_of_many(result: Assembly) -> str:
    """The outcome, and the scans of the largest group in a frame of their own."""
    banner = html.status_banner(result.outcome, result.reason)
    if not result.given:
        return banner
    scans = [_scan_of(result, number) for number in range(len(result.given))]
    lengths = Lengths(scans[result.groups[0][0]].cloud.unit)
    view, _ = group_viewer(scans, result, lengths, _NOTEBOOK_POINTS)
    return _framed(html.page(f"Registration of {len(result.given)} scans", banner, view))


def _framed(page: str) -> str:
    # As high as what is in it, where the notebook lets it say so.
    fit = "this.style.height=this.contentDocument.documentElement.scrollHeight+8+'px'"
    return (
        f'<iframe srcdoc="{escape(page)}" onload="{fit}" '
        'style="width:100%;height:62rem;border:0"></iframe>'
    )


def _scans(result: Registration) -> tuple[Given, Given]:
    if result.given is None:
        raise ValueError(
            "this result does not hold its scans: it is of a pair among many; save the whole"
        )
    given = result.given
    return given_cloud(given.source, "source"), given_cloud(given.target, "target")
