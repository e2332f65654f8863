"""PCD, the Point Cloud Library's format: ascii by NumPy, the binary encodings by Open3D.

Open3D only warns about a truncated file, and fills the rest of an ascii one with zeros; so the
header is read here and what comes back is held against it.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.types import FloatArray

_log = logging.getLogger(__name__)
_LONGEST_HEADER_LINES = 100


def read_pcd(path: Path) -> FloatArray:
    """The points of a PCD file.

    Args:
        path: of an ascii, binary or binary_compressed file. Fields other than x, y, z are skipped,
            and so is the viewpoint.

    Returns:
        (N, 3) float64 points. Rows with NaN, which stand for pixels without a return in organised
        clouds, are dropped; a warning in the log says how many.

    Raises:
        ValueError: it is not a PCD file, lacks x, y or z, or ends before its last point.
    """
    with open(path, "rb") as file:
        header = _read_header(file, path)
        announced = int(header["POINTS"][0])
        points = (
            _read_ascii(file, header, path)
            if header["DATA"] == ["ascii"]
            else _read_by_open3d(path)
        )
    if len(points) != announced:
        raise ValueError(
            f"{path}: truncated: its header announces {announced} points, it holds {len(points)}"
        )
    without_return = np.isnan(points).any(axis=1)
    if without_return.any():
        _log.warning("%s: dropped %d of %d rows of NaN", path, without_return.sum(), len(points))
    return points[~without_return]


def _read_header(file: BinaryIO, path: Path) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    for _ in range(_LONGEST_HEADER_LINES):
        words = file.readline(4096).decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        if "DATA" in header:
            break
    count = (header.get("POINTS") or [""])[0]
    if "DATA" not in header or not count.isdigit():
        raise ValueError(f"{path}: truncated or not a PCD file: its header lacks POINTS or DATA")
    names = header.get("FIELDS", [])
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(
            f"{path}: its FIELDS lack x, y or z: they are {' '.join(names) or 'missing'}"
        )
    return header


def _read_ascii(file: BinaryIO, header: dict[str, list[str]], path: Path) -> FloatArray:
    names = header["FIELDS"]
    rows = [line for line in file.read().splitlines() if line.strip()]
    try:
        widths = [int(count) for count in header.get("COUNT", ["1"] * len(names))]
        columns = [sum(widths[: names.index(axis)]) for axis in "xyz"]
        # All columns, so that NumPy notices a last line that was cut short.
        return np.loadtxt(rows, ndmin=2)[:, columns] if rows else np.empty((0, 3))
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: truncated or damaged points: {error}") from error


def _read_by_open3d(path: Path) -> FloatArray:
    import open3d as o3d

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        return np.asarray(o3d.io.read_point_cloud(path, format="pcd").points).copy()
