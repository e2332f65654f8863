"""Registration from files to files: what ``register.py`` does once its options are read.

Everything is read and checked before anything is written, and every file appears whole or not at
all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import pose_error
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.result import Registration
from skipnet.results.clouds import output_names, write_aligned, write_merged
from skipnet.results.inputs import Given, check_not_overwritten, read_given, read_given_scans
from skipnet.results.pair import pair_page, result_json
from skipnet.results.plan import plan_of
from skipnet.results.project import poses_json, scans_page
from skipnet.scans.scan import Viewpoint
from skipnet.skipmap.tree import points_of
from skipnet.storage import write_bytes, write_text
from skipnet.types import FloatArray, Pair

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly

PAIR_OUTPUTS = ("result.json", "before_after.png", "report.html")
SCANS_OUTPUTS = ("poses.json", "scans.png", "report.html")
MAX_PLANS = 4
"""Groups of which the plan is drawn."""
SIMULATED_FAMILY = "paper_room"
LONG_STAGE = 20
"""Pairs from which on progress is told."""


@dataclass(frozen=True)
class Choices:
    """What a user may choose about a registration: the options of ``skipnet.register``."""

    source_viewpoint: Viewpoint = "auto"
    target_viewpoint: Viewpoint = "auto"
    voxel_size_m: float | None = None
    seed: int = 0
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    unit: str = "auto"
    """Of the coordinates in the files."""
    format: str = "auto"
    """Extension of the clouds to write, beside PLY; "auto" takes that of the files."""
    colour_by_scan: bool = False
    """Merged scans get one colour each, also where they have colours of their own."""


def register_pair_files(
    source: Path, target: Path, output_dir: Path, choices: Choices
) -> Registration:
    """Register two files and write ``PAIR_OUTPUTS`` and the aligned source into a folder.

    Args:
        source: file to move, of a format that ``read_cloud`` knows.
        target: file that stays.
        output_dir: made when missing; files of an earlier run are replaced.
        choices: the options.

    Raises:
        FileNotFoundError: an input is missing; nothing has been written.
        ValueError: an input is no point cloud, or would be overwritten; nothing has been written.
    """
    names = output_names("aligned", [source], choices.format)
    check_not_overwritten([source, target], output_dir, [*PAIR_OUTPUTS, *names])
    given = [read_given(path, choices.unit) for path in (source, target)]
    return _register(given[0], given[1], output_dir, names, choices)


def register_simulated_pair(output_dir: Path, choices: Choices) -> Registration:
    """Simulate two scans of a room, register them, write them and the results into a folder.

    Prints how far the result is from the truth, which the registration never saw.
    """
    from skipnet.simulation.scanning.pairs import simulate_pair
    from skipnet.simulation.seeds import DEMO

    pair = simulate_pair(SIMULATED_FAMILY, DEMO.scene(choices.seed)).pair
    given = []
    for name, points_m in (("source", pair.source_m), ("target", pair.target_m)):
        path = output_dir / f"simulated_{name}.ply"
        write_cloud(path, points_m)
        given.append(Given(path, points_m, Cloud(points_m, name=str(path))))
    names = output_names("aligned", [given[0].path], choices.format)
    result = _register(given[0], given[1], output_dir, names, choices)
    print(_compare_with_truth(result, pair))
    return result


def register_scan_files(paths: Sequence[Path], output_dir: Path, choices: Choices) -> Assembly:
    """Bring many scans together; write ``SCANS_OUTPUTS`` and a merged cloud of each group.

    Pairs are kept in ``output_dir/pairs`` as they are searched: a run that was ended goes on where
    it was. A file may hold several scans. Every scan's viewpoint is the file's or found out; those
    of ``choices`` are for pairs.

    Raises:
        FileNotFoundError: an input is missing; nothing has been written.
        ValueError: an input is no point cloud, or would be overwritten; nothing has been written.
    """
    names = output_names("merged", paths, choices.format)
    check_not_overwritten(paths, output_dir, [*SCANS_OUTPUTS, *names])
    scans = read_given_scans(paths, choices.unit)
    from skipnet.projects.project import register_many

    result = register_many(
        [scan.points_m for scan in scans],
        viewpoints=[scan.viewpoint("auto") for scan in scans],
        voxel_size_m=choices.voxel_size_m,
        seed=choices.seed,
        config=choices.registration,
        folder=output_dir,
        progress=_tell,
    )
    labels = [scan.cloud.name for scan in scans]
    png = _write_groups(scans, result, output_dir, names, choices)
    plan = _plan(scans, result)
    write_text(output_dir / "report.html", scans_page(result, labels, png, plan, choices.seed))
    write_text(output_dir / "poses.json", poses_json(result, labels, choices.seed))
    _announce(result.outcome, result.reason, scans, output_dir)
    return result


def _tell(stage: str, done: int, of: int) -> None:
    """A line on the terminal at every tenth of a long stage."""
    if of >= LONG_STAGE and done and (10 * done) // of > (10 * (done - 1)) // of:
        print(f"{stage}: {done} of {of}", flush=True)


def _register(
    source: Given, target: Given, output_dir: Path, names: Sequence[str], choices: Choices
) -> Registration:
    """Register two scans and write all results of a pair."""
    from skipnet.registration.pipeline import register

    result = register(
        source.points_m,
        target.points_m,
        source_viewpoint=source.viewpoint(choices.source_viewpoint),
        target_viewpoint=target.viewpoint(choices.target_viewpoint),
        voxel_size_m=choices.voxel_size_m,
        seed=choices.seed,
        config=choices.registration,
    )
    _write_pair(source, target, result, output_dir, names, choices.seed)
    return result


def _write_pair(
    source: Given,
    target: Given,
    result: Registration,
    output_dir: Path,
    names: Sequence[str],
    seed: int,
) -> None:
    from skipnet.viz.pictures import draw_before_after
    from skipnet.viz.views import png_bytes

    drawn_m = points_of(source.points_m), points_of(target.points_m)
    png = png_bytes(draw_before_after(*drawn_m, result.T_target_source))
    given = {"source": source, "target": target}
    described = {name: scan.description for name, scan in given.items()}
    inputs = {name: str(scan.path) for name, scan in given.items()}
    facts = {name: scan.facts for name, scan in given.items()}
    write_aligned(source, target, result.T_target_source, output_dir, names)
    write_bytes(output_dir / "before_after.png", png)
    write_text(output_dir / "report.html", pair_page(result, described, png, seed))
    write_text(output_dir / "result.json", result_json(result, inputs, facts, seed))
    outcome = f"{result.status} (confidence {result.confidence:.2f})"
    _announce(outcome, result.reason, [source, target], output_dir)


def _write_groups(
    scans: Sequence[Given],
    result: Assembly,
    output_dir: Path,
    names: Sequence[str],
    choices: Choices,
) -> bytes:
    """Write a merged cloud of each group, and a picture of the largest one; return that."""
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


def _announce(outcome: str, reason: str, scans: Sequence[Given], output_dir: Path) -> None:
    """The outcome on the terminal, below what the readers had to decide."""
    for scan in scans:
        for note in scan.cloud.notes:
            print(f"{scan.cloud.name}: {note}")
    print(f"{outcome}: {reason}")
    print(f"Look at {output_dir / 'report.html'}")


def _compare_with_truth(result: Registration, pair: Pair) -> str:
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    return f"Off the truth by {np.rad2deg(rotation_rad):.4f} deg and {translation_m * 1000:.2f} mm"
