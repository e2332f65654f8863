"""The scans that a run was given as files: read, checked and described."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.las_sizes import unpacked_bytes
from skipnet.clouds.formats.reading import SUPPORTED, read_chunks, read_cloud, read_scans
from skipnet.scans.given import viewpoint_of
from skipnet.scans.scan import Viewpoint, checked
from skipnet.skipmap.streaming import thin_chunks
from skipnet.skipmap.tree import Points, SkipTree, points_of
from skipnet.types import FloatArray

LARGE_FILE_BYTES = 1 << 28
"""What is larger, unpacked, is thinned while it is read, and is never in memory as a whole."""

_IN_FOLDERS = [extension for extension in SUPPORTED if extension not in (".txt", ".png")]
"""What a folder's scans are called; its texts and pictures are more often something else."""
LARGEST_SCENE_M = 2000.0
"""Farther than scanners see: such coordinates are hardly metres."""


@dataclass(frozen=True)
class Given:
    """One scan of a run."""

    path: Path
    points_m: Points
    """All points, or the voxels that a large file is read into."""
    cloud: Cloud
    """The scan as it was read; of a large file its first piece, for what it says of the others."""
    unit: str = "auto"
    is_whole: bool = False
    """The cloud is all that there is, though ``points_m`` be voxels."""

    @property
    def is_large(self) -> bool:
        """Whether ``points_m`` stands for more than is in memory."""
        return isinstance(self.points_m, SkipTree)

    def pieces(self) -> Iterator[Cloud]:
        """The whole scan; a large file is read again, so that every point of it comes."""
        if self.is_whole or not self.is_large:
            return iter([self.cloud])
        return (piece.finite() for piece in read_chunks(self.path, self.unit))

    def viewpoint(self, chosen: Viewpoint) -> Viewpoint:
        """The sensor's position: the chosen one; for "auto" the file's, if it has one."""
        return viewpoint_of(self.cloud) if isinstance(chosen, str) else chosen

    @property
    def description(self) -> str:
        """What was read, for a person."""
        return "; ".join([f"{self.cloud.name}: {self._size}", *self.facts])

    @property
    def facts(self) -> list[str]:
        """What the file said, and what had to be decided."""
        cloud = self.cloud
        facts = [f"with {', '.join(cloud.holds)}"] if cloud.holds else []
        if cloud.viewpoint_m is not None:
            place = ", ".join(f"{coordinate:.3f}" for coordinate in cloud.viewpoint_m)
            facts.append(f"taken from ({place}) as the file says")
        if cloud.unit != "m":
            facts.append(f"in {cloud.unit}, converted to metres")
        return [*facts, *cloud.notes]

    @property
    def _size(self) -> str:
        if isinstance(self.points_m, SkipTree):
            count = self.points_m.moments.count.sum()
            return f"{count:,.0f} points, read into {len(self.points_m):,} voxels"
        return f"{len(self.cloud):,} points"


def given_cloud(cloud: Cloud | SkipTree, name: str) -> Given:
    """A scan that is in memory already."""
    if isinstance(cloud, SkipTree):
        return Given(Path(name), cloud, Cloud(points_of(cloud), name=name), is_whole=True)
    return Given(Path(cloud.name or name), cloud.points_m, cloud, is_whole=True)


def read_given(path: Path, unit: str = "auto") -> Given:
    """Read one file as one scan.

    Raises:
        FileNotFoundError: it is missing.
        ValueError: it is no point cloud.
    """
    if _is_large(path):
        first, places_m = next(read_chunks(path, unit)).finite(), set()

        def points() -> Iterator[FloatArray]:
            """Of one piece after the other; where each was taken from is noted."""
            for piece in read_chunks(path, unit):
                place_m = piece.viewpoint_m
                places_m.add(None if place_m is None else tuple(place_m))
                yield piece.finite().points_m

        tree = checked(thin_chunks(points(), str(path)), str(path))
        if len(places_m) > 1:  # several scans
            first = replace(first, viewpoint_m=None)
        return Given(path, tree, first, unit)
    cloud = _wondering(read_cloud(path, unit), unit)
    return Given(path, checked(cloud.points_m, str(path)), cloud, unit)


def read_given_scans(paths: Sequence[Path], unit: str = "auto") -> list[Given]:
    """Read files as scans: one each, or the several that an E57 or a PTX file holds.

    Raises:
        FileNotFoundError: one is missing.
        ValueError: one is no point cloud, or there is only one scan.
    """
    given = []
    for path in paths:
        if _is_large(path):
            given.append(read_given(path, unit))
            continue
        scans = [_wondering(scan, unit) for scan in read_scans(path, unit)]
        given += [Given(path, checked(scan.points_m, scan.name), scan, unit) for scan in scans]
    if len(given) < 2:
        raise ValueError(f"{paths[0]}: holds one scan: expected two or more, or several files")
    return given


def _wondering(cloud: Cloud, unit: str) -> Cloud:
    """The cloud, with a note if its coordinates are hardly metres and nobody said that they are."""
    extent_m = float(np.ptp(cloud.points_m, axis=0).max())
    if unit != "auto" or cloud.unit != "m" or extent_m <= LARGEST_SCENE_M:
        return cloud
    note = f"extends over {extent_m:,.0f} m: if these are millimetres, say unit=mm"
    return replace(cloud, notes=(*cloud.notes, note))


def find_scans(names: Sequence[str]) -> list[Path]:
    """The files that are meant, each once: files, patterns such as ``scans/*.ply``, what folders
    hold.

    Raises:
        FileNotFoundError: nothing is there.
    """
    found: list[Path] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            inside = sorted(path.iterdir())
            here = [
                file
                for file in inside
                if file.suffix.lower() in _IN_FOLDERS and file.is_file() and not _is_hidden(file)
            ]
        elif path.exists():
            here = [path]
        else:
            anchor = Path(path.anchor) if path.is_absolute() else Path()
            pattern = str(path.relative_to(path.anchor)) if path.is_absolute() else name
            is_pattern = any(mark in name for mark in "*?[")
            matching = sorted(anchor.glob(pattern)) if is_pattern else []
            here = [file for file in matching if not _is_hidden(file)]
        if not here:
            raise FileNotFoundError(f"{name}: no such file, or a folder without scans")
        found += here
    return list(dict.fromkeys(found))


def _is_hidden(file: Path) -> bool:
    """Such as ``._a.ply`` beside ``a.ply``: another program's notes."""
    return file.name.startswith(".")


def check_not_overwritten(paths: Sequence[Path], output_dir: Path, outputs: Sequence[str]) -> None:
    """Refuse inputs that the results would replace.

    Raises:
        ValueError: one would be.
    """
    written = {(output_dir / name).resolve() for name in outputs}
    for path in paths:
        if path.resolve() in written:
            raise ValueError(
                f"{path}: would be overwritten by the results: choose another output_dir"
            )


def _is_large(path: Path) -> bool:
    if not path.is_file():
        return False
    size = path.stat().st_size
    with suppress(ValueError):  # no LAS file; what is wrong with one the reader will say
        size = max(size, unpacked_bytes(path))
    return size > LARGE_FILE_BYTES
