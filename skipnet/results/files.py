"""Registration from files to files: what ``register.py`` does once its options are read.

Everything is read and checked before anything is written, and every file appears whole or not at
all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skipnet.clouds.formats.reading import read_chunks, read_points, write_ply, write_ply_chunks
from skipnet.geometry import pose_error, transform_points
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.result import Registration
from skipnet.results.pair import pair_page, result_json
from skipnet.results.project import poses_json, scans_page
from skipnet.scans.scan import Viewpoint, checked
from skipnet.skipmap.streaming import thin_chunks
from skipnet.skipmap.tree import Cloud, SkipTree, points_of
from skipnet.storage import write_bytes, write_text
from skipnet.types import FloatArray, Pair

if TYPE_CHECKING:
    from skipnet.projects.project import MultiviewResult

PAIR_OUTPUTS = ("result.json", "aligned.ply", "before_after.png", "report.html")
SCANS_OUTPUTS = ("poses.json", "merged.ply", "scans.png", "report.html")
SIMULATED_FAMILY = "paper_room"
LARGE_FILE_BYTES = 1 << 28
"""Larger files are thinned while they are read, and are never in memory as a whole."""


@dataclass(frozen=True)
class Choices:
    """What a user may choose about a registration: the options of ``skipnet.register``."""

    source_viewpoint: Viewpoint = "auto"
    target_viewpoint: Viewpoint = "auto"
    voxel_size_m: float | None = None
    seed: int = 0
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)


def register_pair_files(
    source: Path, target: Path, output_dir: Path, choices: Choices
) -> Registration:
    """Register two files and write ``PAIR_OUTPUTS`` into a folder.

    Args:
        source: file to move, of a format that ``read_points`` knows, in metres.
        target: file that stays.
        output_dir: made when missing; files of an earlier run are replaced.
        choices: the options.

    Raises:
        FileNotFoundError: an input is missing; nothing has been written.
        ValueError: an input is no point cloud, or would be overwritten; nothing has been written.
    """
    source_m, target_m = _read_inputs([source, target], output_dir, PAIR_OUTPUTS)
    result = _register(source_m, target_m, choices)
    inputs = {"source": str(source), "target": str(target)}
    _write_pair(source_m, target_m, result, inputs, output_dir, choices.seed)
    return result


def register_simulated_pair(output_dir: Path, choices: Choices) -> Registration:
    """Simulate two scans of a room, register them, write them and ``PAIR_OUTPUTS`` into a folder.

    Prints how far the result is from the truth, which the registration never saw.
    """
    from skipnet.simulation.scanning.pairs import simulate_pair
    from skipnet.simulation.seeds import DEMO

    pair = simulate_pair(SIMULATED_FAMILY, DEMO.scene(choices.seed)).pair
    inputs = {name: str(output_dir / f"simulated_{name}.ply") for name in ("source", "target")}
    write_ply(inputs["source"], pair.source_m)
    write_ply(inputs["target"], pair.target_m)
    result = _register(pair.source_m, pair.target_m, choices)
    _write_pair(pair.source_m, pair.target_m, result, inputs, output_dir, choices.seed)
    print(_compare_with_truth(result, pair))
    return result


def register_scan_files(
    scans: Sequence[Path], output_dir: Path, choices: Choices
) -> MultiviewResult:
    """Bring many files into the frame of the first and write ``SCANS_OUTPUTS`` into a folder.

    Every scan's viewpoint is found out; those of ``choices`` are for pairs.

    Raises:
        FileNotFoundError: an input is missing; nothing has been written.
        ValueError: an input is no point cloud, or would be overwritten; nothing has been written.
    """
    clouds_m = _read_inputs(scans, output_dir, SCANS_OUTPUTS)
    from skipnet.projects.project import register_many

    result = register_many(
        clouds_m, voxel_size_m=choices.voxel_size_m, seed=choices.seed, config=choices.registration
    )
    names = [str(scan) for scan in scans]
    poses = zip(scans, result.T_first_scan, clouds_m, strict=True)
    placed = [
        (f"{number}: {Path(scan).name}", transform_points(T_first_scan, points_of(cloud_m)))
        for number, (scan, T_first_scan, cloud_m) in enumerate(poses)
        if T_first_scan is not None
    ]
    png = _write_scans([cloud_m for _, cloud_m in placed], [name for name, _ in placed], output_dir)
    write_text(output_dir / "report.html", scans_page(result, names, png, choices.seed))
    write_text(output_dir / "poses.json", poses_json(result, names, choices.seed))
    _announce(result.status, result.reason, output_dir)
    return result


def _read_inputs(paths: Sequence[Path], output_dir: Path, outputs: Sequence[str]) -> list[Cloud]:
    clouds_m = [checked(_read(path), str(path)) for path in paths]
    written = {(output_dir / name).resolve() for name in outputs}
    for path in paths:
        if path.resolve() in written:
            raise ValueError(
                f"{path}: would be overwritten by the results: choose another output_dir"
            )
    return clouds_m


def _is_large(path: str | Path) -> bool:
    return Path(path).is_file() and Path(path).stat().st_size > LARGE_FILE_BYTES


def _read(path: Path) -> Cloud:
    """All points of a file, or the voxels that a large one is read into."""
    return thin_chunks(read_chunks(path), str(path)) if _is_large(path) else read_points(path)


def _register(source_m: Cloud, target_m: Cloud, choices: Choices) -> Registration:
    from skipnet.registration.pipeline import register

    return register(
        source_m,
        target_m,
        source_viewpoint=choices.source_viewpoint,
        target_viewpoint=choices.target_viewpoint,
        voxel_size_m=choices.voxel_size_m,
        seed=choices.seed,
        config=choices.registration,
    )


def _write_pair(
    source_m: Cloud,
    target_m: Cloud,
    result: Registration,
    inputs: Mapping[str, str],
    output_dir: Path,
    seed: int,
) -> None:
    from skipnet.viz.pictures import draw_before_after, png_bytes

    drawn_m = points_of(source_m), points_of(target_m)
    png = png_bytes(draw_before_after(*drawn_m, result.T_target_source))
    described = {
        name: f"{inputs[name]}: {_size(cloud_m)}"
        for name, cloud_m in (("source", source_m), ("target", target_m))
    }
    # A large file is read again, so that every point of it is in the result.
    chunks = read_chunks(inputs["source"]) if isinstance(source_m, SkipTree) else [source_m]
    aligned_m = (transform_points(result.T_target_source, chunk_m) for chunk_m in chunks)
    write_ply_chunks(output_dir / "aligned.ply", aligned_m)
    write_bytes(output_dir / "before_after.png", png)
    write_text(output_dir / "report.html", pair_page(result, described, png, seed))
    write_text(output_dir / "result.json", result_json(result, inputs, seed))
    _announce(f"{result.status} (confidence {result.confidence:.2f})", result.reason, output_dir)


def _size(cloud_m: Cloud) -> str:
    if isinstance(cloud_m, SkipTree):
        return f"{cloud_m.moments.count.sum():,.0f} points, read into {len(cloud_m):,} voxels"
    return f"{len(cloud_m):,} points"


def _write_scans(placed_m: Sequence[FloatArray], names: Sequence[str], output_dir: Path) -> bytes:
    """Write the merged cloud, each scan in its colour, and a picture of it; return the picture."""
    from matplotlib.colors import to_rgb

    from skipnet.viz.pictures import draw_scans, png_bytes, scan_colour

    tints = [np.multiply(to_rgb(scan_colour(index)), 255) for index in range(len(placed_m))]
    colours = np.repeat(tints, [len(points_m) for points_m in placed_m], axis=0).round()
    write_ply(output_dir / "merged.ply", np.concatenate(placed_m), colours.astype(np.uint8))
    png = png_bytes(draw_scans(placed_m, names))
    write_bytes(output_dir / "scans.png", png)
    return png


def _announce(outcome: str, reason: str, output_dir: Path) -> None:
    print(f"{outcome}: {reason}")
    print(f"Look at {output_dir / 'report.html'}")


def _compare_with_truth(result: Registration, pair: Pair) -> str:
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    return f"Off the truth by {np.rad2deg(rotation_rad):.4f} deg and {translation_m * 1000:.2f} mm"
