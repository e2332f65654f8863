"""Reading the points of any supported file; every error names the file and what was expected."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from skipnet.clouds.pcd import read_pcd
from skipnet.clouds.ply import RECORDS_AT_ONCE, read_ply, write_ply, write_ply_chunks
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


def _read_text(path: Path) -> FloatArray:
    """Columns split by blanks, commas or semicolons; a header may say which are x, y, z."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file: expected lines of x y z") from error
    rows = [line for line in lines if line.strip() and not line.lstrip().startswith(("#", "//"))]
    if not rows:
        raise ValueError(f"{path}: holds no points")
    delimiter = next((mark for mark in ";," if mark in rows[0]), None)
    columns = [0, 1, 2]
    if not _is_number(rows[0].split(delimiter)[0]):
        columns = _header_columns(
            [word.strip(' "').lower() for word in rows[0].split(delimiter)], path
        )
        rows = rows[1:]
    try:
        # Reading every column, not only three, lets NumPy notice a last line that was cut short.
        table = np.loadtxt(rows, delimiter=delimiter, ndmin=2) if rows else np.empty((0, 3))
        return table[:, columns]
    except (ValueError, IndexError) as error:
        raise ValueError(
            f"{path}: expected lines of at least three numbers x y z: {error}"
        ) from error


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _header_columns(names: list[str], path: Path) -> list[int]:
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(
            f"{path}: not a point file: its first line holds neither numbers nor x, y, z"
        )
    return [names.index(axis) for axis in "xyz"]


def _read_numpy(path: Path) -> FloatArray:
    try:
        array = np.load(path, allow_pickle=False)
        if isinstance(array, np.lib.npyio.NpzFile):
            array = _single_array(array, path)
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(f"{path}: truncated or not a NumPy file: {error}") from error
    except Exception as error:  # zipfile.BadZipFile and friends have no common base
        raise ValueError(f"{path}: truncated or not a NumPy archive: {error}") from error
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "iuf":
        raise ValueError(
            f"{path}: holds {array.dtype} of shape {array.shape}: expected (N, 3) numbers"
        )
    return array[:, :3].astype(np.float64)


def _single_array(archive: np.lib.npyio.NpzFile, path: Path) -> np.ndarray:
    name = (
        "points"
        if "points" in archive.files
        else archive.files[0]
        if len(archive.files) == 1
        else None
    )
    if name is None:
        raise ValueError(f"holds the arrays {archive.files}: expected one called 'points'")
    return archive[name]


def _read_las(path: Path) -> Iterator[FloatArray]:
    try:
        import laspy
    except ModuleNotFoundError as error:
        raise _missing_package(path, "laspy") from error
    present = 0
    try:
        with laspy.open(path) as file:
            announced = file.header.point_count
            for cloud in file.chunk_iterator(RECORDS_AT_ONCE):
                present += len(cloud)
                # Scaled by hand: the chunk's own x, y, z would make three more copies.
                raw = np.stack([cloud.X, cloud.Y, cloud.Z], axis=1)
                yield raw * file.header.scales + file.header.offsets
    except Exception as error:  # laspy and its decompressors raise many kinds for a damaged file
        raise ValueError(f"{path}: truncated or not a LAS/LAZ file: {error}") from error
    if present != announced:
        raise ValueError(
            f"{path}: truncated: its header announces {announced} points, it holds {present}"
        )


def _read_e57(path: Path) -> FloatArray:
    """All scans of the file, in the file's common frame."""
    try:
        import pye57
    except ModuleNotFoundError as error:
        raise _missing_package(path, "pye57") from error
    axes = ("cartesianX", "cartesianY", "cartesianZ")
    try:
        file = pye57.E57(str(path))
        scans = [
            file.read_scan(index, ignore_missing_fields=True) for index in range(file.scan_count)
        ]
        return np.concatenate([np.stack([scan[axis] for axis in axes], axis=1) for scan in scans])
    except Exception as error:  # libE57Format has its own exception, raised through pybind11
        raise ValueError(f"{path}: truncated or not an E57 file: {error}") from error


def _missing_package(path: Path, package: str) -> ModuleNotFoundError:
    return ModuleNotFoundError(
        f"{path}: reading {path.suffix} needs the package {package}: pip install 'skipnet[formats]'"
    )


_READERS: dict[str, Callable[[Path], Iterator[FloatArray]]] = {
    ".ply": read_ply,
    ".pcd": _whole(read_pcd),
    **dict.fromkeys((".xyz", ".txt", ".csv"), _whole(_read_text)),
    **dict.fromkeys((".npy", ".npz"), _whole(_read_numpy)),
    **dict.fromkeys((".las", ".laz"), _read_las),
    ".e57": _whole(_read_e57),
}
SUPPORTED = tuple(_READERS)
"""Every extension that ``read_points`` knows."""
