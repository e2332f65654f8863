"""Writing clouds in the format that a file's extension names."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import chain, groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from skipnet.checks import METRES_PER_UNIT, as_path
from skipnet.clouds.cloud import Cloud, as_cloud, concatenate
from skipnet.clouds.formats.arrays import write_npy, write_npz
from skipnet.clouds.formats.columns import columns_of_cloud
from skipnet.clouds.formats.e57_writing import write_e57
from skipnet.clouds.formats.las import write_las
from skipnet.clouds.formats.pcd import write_pcd
from skipnet.clouds.formats.ply import write_ply
from skipnet.storage import replacing

_log = logging.getLogger(__name__)
_TEXTS = (".xyz", ".txt", ".asc", ".csv")


def write_cloud(
    path: str | os.PathLike[str], cloud: Cloud | npt.ArrayLike | Iterator[Cloud]
) -> None:
    """Write a cloud, whole or not at all; an existing file is replaced.

    Coordinates are written in the cloud's unit (E57: metres), as doubles where the format has
    them, with colours, intensities, normals and columns. What a format has no room for is said
    by a warning of this module's logger.

    Args:
        path: its extension names the format, one of ``WRITABLE``.
        cloud: to write; (N, 3) points; or an iterator over pieces of one cloud, which PLY and text
            write without holding all of them.

    Raises:
        ValueError: there is no writer for the extension.
    """
    path = as_path(path, "path")
    pieces = cloud if isinstance(cloud, Iterator) else iter([as_cloud(cloud)])
    _write(path, _scans_of(pieces) if path.suffix.lower() == ".e57" else pieces)


def _scans_of(pieces: Iterator[Cloud]) -> Iterator[Cloud]:
    """Pieces that follow each other, of one name and taken from one place, are one scan's."""

    def scan(piece: Cloud) -> tuple[str, bytes]:
        place_m = piece.viewpoint_m
        return piece.name, b"" if place_m is None else place_m.tobytes()

    return (concatenate(list(same)) for _, same in groupby(pieces, scan))


def write_scans(path: str | os.PathLike[str], scans: Iterable[Cloud]) -> None:
    """Write scans that are in one frame: E57 keeps them apart, other formats as one cloud."""
    scans, path = list(scans), Path(path)
    _write(path, iter(scans if path.suffix.lower() == ".e57" else [concatenate(scans)]))


def writable(path: str | os.PathLike[str]) -> bool:
    """Whether there is a writer for a file of this name."""
    return Path(path).suffix.lower() in _WRITERS


def _write(path: Path, clouds: Iterator[Cloud]) -> None:
    """Write, and say what has been lost, as the first piece has it."""
    write, first = _writer(path), next(clouds)
    write(path, chain([first], clouds))
    if lost := _lost(path.suffix.lower(), first):
        _log.warning("%s: written without %s", path, ", ".join(lost))


def _lost(extension: str, cloud: Cloud) -> list[str]:
    """What a cloud holds and a format has no room for."""
    if extension == ".npy":
        return cloud.holds
    lost = []
    if cloud.crs and extension in (*_TEXTS, ".pcd"):
        lost.append("its coordinate system")
    if cloud.unit != "m" and extension in (".pcd", ".npz"):
        lost.append(f"the word that it is in {cloud.unit}")
    if cloud.viewpoint_m is not None and extension in _TEXTS:
        lost.append("the sensor's place")
    return lost


def _writer(path: str | os.PathLike[str]) -> Callable[[Path, Iterable[Cloud]], None]:
    extension = Path(path).suffix.lower()
    if extension not in _WRITERS:
        raise ValueError(
            f"{path}: cannot write {extension or '(no extension)'!r}: "
            f"expected one of {', '.join(WRITABLE)}"
        )
    return _WRITERS[extension]


def _whole(write: Callable[[Path, Cloud], None]) -> Callable[[Path, Iterable[Cloud]], None]:
    """A writer of pieces from one of whole clouds."""

    def write_in_one_piece(path: Path, clouds: Iterable[Cloud]) -> None:
        """All pieces at once."""
        write(path, concatenate(list(clouds)))

    return write_in_one_piece


def _write_text(path: Path, clouds: Iterable[Cloud], delimiter: str) -> None:
    """A header with the names of the columns, then a point per line, to 10 micrometres or finer."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        for number, cloud in enumerate(clouds):
            table = columns_of_cloud(cloud)
            if number == 0:
                names = [name.replace(" ", "_") for name in table]
                if cloud.unit != "m":
                    names[:3] = [f"{axis}_{cloud.unit}" for axis in "xyz"]
                start = "" if delimiter == "," else "//"
                file.write(start + delimiter.join(names) + "\n")
            place = "%.8f" if METRES_PER_UNIT[cloud.unit] > 1 else "%.5f"
            formats = [place, place, place, *map(_number, list(table.values())[3:])]
            np.savetxt(file, np.column_stack(list(table.values())), formats, delimiter)


def _number(values: np.ndarray) -> str:
    """How a column is written: so that times of GPS keep their microseconds."""
    return "%.9g" if values.dtype == np.float32 else "%.15g"


_WRITERS: dict[str, Callable[[Path, Iterable[Cloud]], None]] = {
    ".ply": write_ply,
    ".pcd": write_pcd,
    **dict.fromkeys((".las", ".laz"), write_las),
    ".e57": write_e57,
    **dict.fromkeys((".xyz", ".txt", ".asc"), partial(_write_text, delimiter=" ")),
    ".csv": partial(_write_text, delimiter=","),
    ".npy": _whole(write_npy),
    ".npz": _whole(write_npz),
}
WRITABLE = tuple(_WRITERS)
"""Every extension that ``write_cloud`` knows."""
