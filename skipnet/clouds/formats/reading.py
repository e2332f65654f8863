"""Reading the points of any supported file; every error names the file and what was expected."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from skipnet.clouds.formats.arrays import read_numpy
from skipnet.clouds.formats.e57 import read_e57
from skipnet.clouds.formats.las import read_las
from skipnet.clouds.formats.pcd import read_pcd
from skipnet.clouds.formats.ply import read_ply, write_ply, write_ply_chunks
from skipnet.clouds.formats.text import read_text
from skipnet.types import FloatArray

__all__ = ["SUPPORTED", "read_chunks", "read_points", "write_ply", "write_ply_chunks"]


def read_points(path: str | os.PathLike[str]) -> FloatArray:
    """Read a file's points, whatever its format.

    Args:
        path: of a file with one of the extensions in ``SUPPORTED``; coordinates in metres.

    Returns:
        (N, 3) float64 points, N >= 1. Rows of NaN in PCD files, which stand for beams without a
        return, are dropped and their number is logged; elsewhere NaN stays, for ``validate`` to
        refuse.

    Raises:
        FileNotFoundError: no such file.
        ValueError: unknown extension, or an empty, truncated or damaged file.
        ModuleNotFoundError: the format needs an optional package; the message holds
            the pip command.
    """
    chunks = list(read_chunks(path))
    return chunks[0] if len(chunks) == 1 else np.concatenate(chunks)


def read_chunks(path: str | os.PathLike[str]) -> Iterator[FloatArray]:
    """As ``read_points``, 262,144 points at a time where the format allows it.

    Binary PLY, LAS and LAZ do; other files come in one piece. Errors in a file's middle are raised
    when the reading gets there.

    Yields:
        (n, 3) float64 points, n >= 1.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder: expected a file with points")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(
            f"{path}: unknown extension {path.suffix or '(none)'!r}: "
            f"expected one of {', '.join(SUPPORTED)}"
        )
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    is_empty = True
    for points in reader(path):
        if len(points):
            is_empty = False
            yield points
    if is_empty:
        raise ValueError(f"{path}: holds no points")


def _whole(read: Callable[[Path], FloatArray]) -> Callable[[Path], Iterator[FloatArray]]:
    """A reader of chunks from a reader of whole files."""

    def read_in_one_piece(path: Path) -> Iterator[FloatArray]:
        """The whole file as the only chunk."""
        yield read(path)

    return read_in_one_piece


_READERS: dict[str, Callable[[Path], Iterator[FloatArray]]] = {
    ".ply": read_ply,
    ".pcd": _whole(read_pcd),
    **dict.fromkeys((".xyz", ".txt", ".csv"), _whole(read_text)),
    **dict.fromkeys((".npy", ".npz"), _whole(read_numpy)),
    **dict.fromkeys((".las", ".laz"), read_las),
    ".e57": _whole(read_e57),
}
SUPPORTED = tuple(_READERS)
"""Every extension that ``read_points`` knows."""
