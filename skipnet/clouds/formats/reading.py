"""Reading any supported file; its content decides which reader, every error names the file."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from skipnet.checks import METRES_PER_UNIT, as_path, check_known
from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats.arrays import read_numpy
from skipnet.clouds.formats.columns import settled_colour
from skipnet.clouds.formats.depth import read_depth
from skipnet.clouds.formats.e57 import read_e57
from skipnet.clouds.formats.kitti import read_kitti
from skipnet.clouds.formats.las import read_las, without_unused
from skipnet.clouds.formats.meshes import read_mesh
from skipnet.clouds.formats.pcd import read_pcd
from skipnet.clouds.formats.ply import read_ply
from skipnet.clouds.formats.ptx import read_ptx
from skipnet.clouds.formats.text import read_text
from skipnet.types import FloatArray

_log = logging.getLogger(__name__)
_MAGIC: dict[bytes, str] = {
    b"ply": ".ply",
    b"# .PCD": ".pcd",
    b"VERSION": ".pcd",
    b"LASF": ".las",
    b"ASTM-E57": ".e57",
    b"\x93NUMPY": ".npy",
    b"PK\x03\x04": ".npz",
    b"glTF": ".glb",
    b"\x89PNG\r\n\x1a\n": ".png",
}
"""How files begin whose format names itself."""
_TEXTS = (".xyz", ".txt", ".csv", ".asc", ".pts")
_LAS = (".las", ".laz")
_SCANS = (".e57", ".ptx")
"""Formats that may hold several scans."""
_LONGEST_LINE = 480
"""Letters of an error."""
_FARTHEST_VIEWPOINT = 2.0
"""A sensor that stands farther from its points than so many of their diagonals is not believed."""


def read_cloud(path: str | os.PathLike[str], unit: str = "auto") -> Cloud:
    """Read a file: its points with colours, intensities and whatever else it holds of them.

    Args:
        path: of a file; its content decides on the format, then its extension (``SUPPORTED``).
        unit: of its coordinates, a key of ``skipnet.checks.METRES_PER_UNIT``; "auto" takes
            the one that the file names, else metres.

    Returns:
        The cloud, N >= 1, in metres; of a file with several scans all of them, in the frame of the
        file. Rows of NaN, which stand for beams that met nothing, are left out, and a note of the
        cloud says how many.

    Raises:
        FileNotFoundError: no such file.
        ValueError: unknown format, or an empty, truncated or damaged file.
        ModuleNotFoundError: the format needs an optional package; the message holds the pip
            command.
    """
    path = as_path(path, "path")
    chunks = list(read_chunks(path, unit, whole_scans=True))
    return _finished(replace(_joined(chunks, path), name=str(path)))


def read_points(path: str | os.PathLike[str], unit: str = "auto") -> FloatArray:
    """The (N, 3) float64 points of a file in metres, as ``read_cloud`` reads them."""
    return read_cloud(path, unit).points_m


def read_scans(path: str | os.PathLike[str], unit: str = "auto") -> list[Cloud]:
    """As ``read_cloud``, each scan of a file that holds several (E57, PTX) on its own."""
    chunks = list(read_chunks(path, unit, whole_scans=True))
    if _format_of(Path(path)) not in _SCANS:
        return [_finished(_joined(chunks, Path(path)))]
    return [_finished(scan) for scan in chunks]


def read_chunks(
    path: str | os.PathLike[str], unit: str = "auto", whole_scans: bool = False
) -> Iterator[Cloud]:
    """As ``read_cloud``, 262,144 points at a time where the format allows it, rows of NaN included;
    with ``whole_scans`` one cloud for each scan of a file that holds several.

    Errors in a file's middle are raised when the reading gets there.

    Yields:
        Clouds of one point or more.
    """
    path = as_path(path, "path")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder: expected a file with points")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    if unit != "auto":
        check_known("unit", unit, tuple(METRES_PER_UNIT))
    is_empty = True
    extension = _format_of(path)
    options = {"in_pieces": not whole_scans} if extension == ".e57" else {}
    with _clear_errors(path):
        for cloud in _READERS[extension](path, **options):
            if len(cloud):
                is_empty = False
                yield cloud if unit in ("auto", cloud.unit) else _in_unit(cloud, unit)
    if is_empty:
        raise ValueError(f"{path}: holds no points")


def _joined(chunks: list[Cloud], path: Path) -> Cloud:
    """The pieces of a file as one, without dimensions that only its format has."""
    return concatenate(without_unused(chunks) if _format_of(path) in _LAS else chunks)


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    """Errors name the file, and what they repeat of it is shown as far as it is text, and short."""
    try:
        yield
    except ValueError as error:
        message = str(error)
        if str(path.parent) not in message:  # of a library that did not know it
            message = f"{path}: damaged: {message}"
        shown = "".join(letter if letter.isprintable() else "?" for letter in message)
        if str(error) == shown[:_LONGEST_LINE]:
            raise
        raise ValueError(shown[:_LONGEST_LINE]) from error


def _format_of(path: Path) -> str:
    """The extension that the content stands for: its own sign first, then the file's name."""
    with open(path, "rb") as file:
        head = file.read(512)
    for magic, extension in _MAGIC.items():
        if head.startswith(magic):
            return extension
    extension = path.suffix.lower()
    if extension in _TEXTS and _looks_like_ptx(head):
        return ".ptx"
    if extension not in _READERS or extension in _MAGIC.values():
        # Of a format that names itself, and does not: text is text, whatever it is called.
        if _looks_like_ptx(head):
            return ".ptx"
        if _looks_like_rows(head):
            return ".txt"
        if extension not in _READERS:
            raise ValueError(
                f"{path}: unknown extension {path.suffix or '(none)'!r}: "
                f"expected one of {', '.join(SUPPORTED)}"
            )
    return extension


def _looks_like_ptx(head: bytes) -> bool:
    """Whether a file begins as a PTX scan does: two counts, four lines of three, some of four."""
    lines = [line.split() for line in head.splitlines()[:8]]
    if [len(words) for words in lines] != [1, 1, 3, 3, 3, 3, 4, 4]:
        return False
    return all(words[0].isdigit() for words in lines[:2])


def _looks_like_rows(head: bytes) -> bool:
    """Whether a file begins with a line of three numbers or more."""
    words = head.splitlines()[0].replace(b",", b" ").replace(b";", b" ").split() if head else []
    try:
        return len([float(word) for word in words]) >= 3
    except ValueError:
        return False


def _in_unit(cloud: Cloud, unit: str) -> Cloud:
    """The cloud as if its file had named the unit."""
    factor = METRES_PER_UNIT[unit] / METRES_PER_UNIT[cloud.unit]
    viewpoint_m = None if cloud.viewpoint_m is None else cloud.viewpoint_m * factor
    return replace(
        cloud,
        points_m=cloud.points_m * factor,
        offset_m=cloud.offset_m * factor,
        viewpoint_m=viewpoint_m,
        unit=unit,
    )


def _finished(cloud: Cloud) -> Cloud:
    """Without rows of NaN and without a viewpoint that cannot be right."""
    cloud = replace(cloud, colour=settled_colour(cloud.colour)).finite()
    if not len(cloud):
        raise ValueError(f"{cloud.name}: holds no points but NaN or infinity")
    place_m = cloud.viewpoint_m
    if place_m is not None:
        low_m, high_m = cloud.points_m.min(axis=0), cloud.points_m.max(axis=0)
        beyond_m = np.linalg.norm(np.maximum(0, np.maximum(low_m - place_m, place_m - high_m)))
        if beyond_m > _FARTHEST_VIEWPOINT * np.linalg.norm(high_m - low_m):
            note = f"its viewpoint lies {beyond_m:.0f} m from its points and is not used"
            cloud = replace(cloud, viewpoint_m=None, notes=(*cloud.notes, note))
    for note in cloud.notes:
        _log.info("%s: %s", cloud.name, note)
    return cloud


_READERS: dict[str, Callable[..., Iterator[Cloud]]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    **dict.fromkeys(_TEXTS, read_text),
    ".ptx": read_ptx,
    **dict.fromkeys((".npy", ".npz"), read_numpy),
    **dict.fromkeys(_LAS, read_las),
    ".e57": read_e57,
    ".bin": read_kitti,
    ".png": read_depth,
    **{f".{kind}": partial(read_mesh, kind=kind) for kind in ("obj", "stl", "glb", "off")},
}
SUPPORTED = tuple(_READERS)
"""Every extension that ``read_cloud`` knows."""
