"""Registration from files to files: what ``register.py`` does once its options are read.

Everything is read and checked before anything is written, and every file appears whole or not at
all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import pose_error
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.progress import clear, tell
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.prior import Prior
from skipnet.registration.result import Registration
from skipnet.results.closing import closing_rows
from skipnet.results.clouds import output_names, write_aligned
from skipnet.results.folder import new_results
from skipnet.results.inputs import Given, check_not_overwritten, read_given
from skipnet.results.pair import pair_page, result_json
from skipnet.results.views import pair_viewer
from skipnet.scans.scan import Viewpoint
from skipnet.skipmap.tree import points_of
from skipnet.storage import write_bytes, write_text
from skipnet.types import Pair
from skipnet.viz.lengths import Lengths

PAIR_OUTPUTS = ("result.json", "before_after.png", "report.html")
SIMULATED_FAMILY = "paper_room"


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
    prior: Prior | None = None
    """A pose that somebody believes in, judged like any other."""
    colour_by_scan: bool = False
    """Merged scans get one colour each, also where they have colours of their own."""
    source_unit: str | None = None
    """Of the source's coordinates, where it is another than ``unit``."""


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
    given = []
    for path, unit in ((source, choices.source_unit or choices.unit), (target, choices.unit)):
        tell(f"reading {path.name}")
        given.append(read_given(path, unit))
    return _register_and_write(given, output_dir, names, choices)


def register_simulated_pair(output_dir: Path, choices: Choices) -> Registration:
    """Simulate two scans of a room, register them, write them and the results into a folder.

    Prints how far the result is from the truth, which the registration never saw.
    """
    from skipnet.simulation.scanning.pairs import simulate_pair
    from skipnet.simulation.seeds import DEMO

    tell("simulating two scans")
    pair = simulate_pair(SIMULATED_FAMILY, DEMO.scene(choices.seed)).pair
    given = []
    for name, points_m in (("source", pair.source_m), ("target", pair.target_m)):
        path = output_dir / f"simulated_{name}.ply"
        given.append(Given(path, points_m, Cloud(points_m, name=str(path))))
    names = output_names("aligned", [given[0].path], choices.format)
    with new_results(output_dir) as folder:
        for scan in given:
            write_cloud(folder / scan.path.name, scan.cloud)
        result = _register(given[0], given[1], choices)
        closing = write_pair(given[0], given[1], result, folder, names, choices.seed)
    announce(str(result), closing, given, output_dir)
    print(_compare_with_truth(result, pair))
    return result


def _register_and_write(
    given: Sequence[Given], output_dir: Path, names: Sequence[str], choices: Choices
) -> Registration:
    source, target = given
    with new_results(output_dir) as folder:
        result = _register(source, target, choices)
        closing = write_pair(source, target, result, folder, names, choices.seed)
    announce(str(result), closing, given, output_dir)
    return result


def _register(source: Given, target: Given, choices: Choices) -> Registration:
    from skipnet.registration.pipeline import register

    return register(
        source.points_m,
        target.points_m,
        source_viewpoint=source.viewpoint(choices.source_viewpoint),
        target_viewpoint=target.viewpoint(choices.target_viewpoint),
        voxel_size_m=choices.voxel_size_m,
        seed=choices.seed,
        config=choices.registration,
        prior=choices.prior,
    )


@one_blas_thread
def write_pair(
    source: Given,
    target: Given,
    result: Registration,
    folder: Path,
    names: Sequence[str],
    seed: int,
) -> list[tuple[str, str]]:
    """Write all results of a pair into a folder.

    Returns:
        The rows of the closing table.
    """
    tell("drawing")
    lengths = Lengths(target.cloud.unit)
    drawings: list[Callable[[], Any]] = [
        partial(_picture, source, target, result),
        partial(pair_viewer, source, target, result, lengths),
    ]
    png, (view, residuals_m) = side_by_side(lambda draw: draw(), drawings)
    given = {"source": source, "target": target}
    described = {name: scan.description for name, scan in given.items()}
    inputs = {name: str(scan.path) for name, scan in given.items()}
    facts = {name: scan.facts for name, scan in given.items()}
    tell("writing")
    write_aligned(source, target, result.T_target_source, folder, names)
    write_bytes(folder / "before_after.png", png)
    page = pair_page(result, described, view, residuals_m, png, seed, lengths)
    write_text(folder / "report.html", page)
    write_text(folder / "result.json", result_json(result, inputs, facts, seed, lengths))
    written = sorted(path.name for path in folder.iterdir())
    return closing_rows(result, residuals_m, lengths, written)


def _picture(source: Given, target: Given, result: Registration) -> bytes:
    """before_after.png."""
    from skipnet.viz.pictures import draw_before_after
    from skipnet.viz.views import png_bytes

    drawn_m = points_of(source.points_m), points_of(target.points_m)
    return png_bytes(draw_before_after(*drawn_m, result.T_target_source))


def announce(
    outcome: str, rows: Sequence[tuple[str, str]], scans: Sequence[Given], output_dir: Path
) -> None:
    """The outcome on the terminal with its table, below what the readers had to decide."""
    clear()
    for scan in scans:
        for note in scan.cloud.notes:
            print(f"{scan.cloud.name}: {note}")
    print(outcome)
    print("\n".join(f"  {name:<12} {words}" for name, words in rows))
    print(f"Look at {output_dir / 'report.html'}")


def _compare_with_truth(result: Registration, pair: Pair) -> str:
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    return f"Off the truth by {np.rad2deg(rotation_rad):.4f} deg and {translation_m * 1000:.2f} mm"
