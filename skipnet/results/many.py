"""Many scans from files to files: read, brought together, written group by group."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.parallel.threads import one_blas_thread
from skipnet.progress import tell
from skipnet.results.closing import many_rows
from skipnet.results.clouds import output_names, write_merged
from skipnet.results.files import Choices, announce
from skipnet.results.folder import new_results
from skipnet.results.group_views import group_viewer
from skipnet.results.inputs import Given, check_not_overwritten, read_given_scans
from skipnet.results.plan import plan_of
from skipnet.results.project import poses_json, scans_page
from skipnet.skipmap.tree import points_of
from skipnet.storage import write_bytes, write_text
from skipnet.types import FloatArray
from skipnet.viz.lengths import Lengths

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly
    from skipnet.projects.blocks import Workers

SCANS_OUTPUTS = ("poses.json", "scans.png", "report.html")
MAX_PLANS = 4
"""Groups of which the plan is drawn."""


def register_scan_files(
    paths: Sequence[Path],
    output_dir: Path,
    choices: Choices,
    beliefs: Path | None = None,
    workers: Workers | None = None,
) -> Assembly:
    """Bring many scans together; write ``SCANS_OUTPUTS`` and a merged cloud of each group.

    Pairs are kept in ``output_dir/pairs`` as they are searched: a run that was ended goes on where
    it was. A file may hold several scans. Every scan's viewpoint is the file's or found out; those
    of ``choices`` are for pairs.

    Args:
        paths: files of scans.
        output_dir: made when missing; files of an earlier run are replaced.
        choices: the options.
        beliefs: file of what somebody believes of the scans.
        workers: who searches the pairs; None: this process.

    Raises:
        FileNotFoundError: an input is missing; nothing has been written.
        ValueError: an input is no point cloud, or would be overwritten; nothing has been written.
    """
    names = output_names("merged", paths, choices.format)
    check_not_overwritten(paths, output_dir, [*SCANS_OUTPUTS, *names])
    tell("reading the scans")
    scans = read_given_scans(paths, choices.unit)
    from skipnet.projects.register import register_many
    from skipnet.results.beliefs import read_priors

    names_of_scans = [scan.cloud.name for scan in scans]
    priors = None if beliefs is None else read_priors(beliefs, names_of_scans)
    if priors is not None:
        priors.check(len(scans))
    with new_results(output_dir) as folder:
        result = register_many(
            [scan.points_m for scan in scans],
            viewpoints=[scan.viewpoint("auto") for scan in scans],
            voxel_size_m=choices.voxel_size_m,
            seed=choices.seed,
            config=choices.registration,
            folder=output_dir,
            progress=tell,
            workers=workers,
            priors=priors,
        )
        rows = write_many(scans, result, folder, names, choices)
    announce(str(result), rows, scans, output_dir)
    return result


@one_blas_thread
def write_many(
    scans: Sequence[Given],
    result: Assembly,
    folder: Path,
    names: Sequence[str],
    choices: Choices,
) -> list[tuple[str, str]]:
    """Write all results of many scans into a folder.

    Returns:
        The rows of the closing table.
    """
    tell("drawing and writing")
    labels = [scan.cloud.name for scan in scans]
    lengths = Lengths(scans[result.groups[0][0]].cloud.unit)
    png = _write_groups(scans, result, folder, names, choices)
    view = group_viewer(scans, result, lengths)
    inputs = [scan.description for scan in scans]
    page = scans_page(
        result, labels, view, (png, _plan(scans, result)), choices.seed, lengths, inputs
    )
    write_text(folder / "report.html", page)
    write_text(folder / "poses.json", poses_json(result, labels, choices.seed, lengths))
    return many_rows(result, lengths, sorted(path.name for path in folder.iterdir()))


def _write_groups(
    scans: Sequence[Given],
    result: Assembly,
    output_dir: Path,
    names: Sequence[str],
    choices: Choices,
) -> bytes:
    """Write a merged cloud of each group and a picture of the largest, which comes back."""
    from matplotlib.colors import to_rgb

    from skipnet.viz.colours import scan_colour
    from skipnet.viz.pictures import draw_scans
    from skipnet.viz.views import png_bytes

    large = [group for group in result.groups if len(group) > 1] or result.groups[:1]
    for number, group in enumerate(large):
        placed = [_placed(scans[scan], result.T_group_scan[scan]) for scan in group]
        tints = [np.multiply(to_rgb(scan_colour(index)), 255) for index in range(len(placed))]
        own = [_numbered(name, number) for name in names]
        write_merged(placed, tints, choices.colour_by_scan, output_dir, own)
        if number == 0:
            labels = [f"{scan}: {Path(scans[scan].cloud.name).name}" for scan in group]
            png = png_bytes(draw_scans([cloud.points_m for cloud in placed], labels))
    write_bytes(output_dir / "scans.png", png)
    return png


def _numbered(name: str, group: int) -> str:
    """``merged.ply`` of the largest group, ``merged_1.ply`` of the next."""
    path = Path(name)
    return name if group == 0 else f"{path.stem}_{group}{path.suffix}"


def _placed(scan: Given, T_group_scan: FloatArray) -> Cloud:
    cloud = Cloud(points_of(scan.points_m)) if scan.is_large else scan.cloud
    return cloud.moved(T_group_scan)


def _plan(scans: Sequence[Given], result: Assembly) -> bytes:
    """The picture of the groups from above with their links."""
    from skipnet.viz.plans import draw_plans
    from skipnet.viz.views import png_bytes

    large = [group for group in result.groups if len(group) > 1] or result.groups[:1]
    return png_bytes(draw_plans([plan_of(scans, result, group) for group in large[:MAX_PLANS]]))
