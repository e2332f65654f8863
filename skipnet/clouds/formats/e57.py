"""E57 files, through pye57: each scan with its pose, colours and intensity.

The library believes the record count of the header and leaves the rest of its buffers as they
were, and nests as deep as the XML does; so points are read a piece at a time and counted, and the
XML is looked at first.
Format: ASTM E2807.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.checks import missing_package
from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import FINE, as_colour, stacked
from skipnet.clouds.formats.e57_xml import check_xml
from skipnet.geometry import make_transform
from skipnet.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    import pye57

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_KINDS = {
    **dict.fromkeys(
        (*_CARTESIAN, *_SPHERICAL, *_COLOURS, *_NORMALS, "intensity", "timeStamp"), np.float64
    ),
    **dict.fromkeys(("rowIndex", "columnIndex", "returnIndex", "returnCount"), np.longlong),
    **dict.fromkeys(("cartesianInvalidState", "sphericalInvalidState"), np.int8),
}
_HIDDEN = {*_CARTESIAN, *_SPHERICAL, *_COLOURS, *_NORMALS, "intensity"}
_HIDDEN |= {"cartesianInvalidState", "sphericalInvalidState"}
OWN_COLUMNS = "skipnet:"
"""How columns begin that the standard has no name for."""
_FINE = tuple(f"{OWN_COLUMNS}{name}" for name in FINE)
_HIDDEN |= set(_FINE)


def read_e57(path: Path, in_pieces: bool = False) -> Iterator[Cloud]:
    """The scans of the file, one after the other, in the file's common frame.

    A scan's viewpoint is its pose's place, where it has a pose. Points that the scanner marked as
    invalid are left out.

    Args:
        path: of the file.
        in_pieces: each scan comes as several clouds, so that no more than one need be in memory.

    Raises:
        ValueError: it is damaged or ends before its last point.
    """
    try:
        import pye57
    except ModuleNotFoundError as error:
        raise missing_package(path, "pye57") from error
    check_xml(path)
    with _errors_of(path):
        file = pye57.E57(str(path))
    try:
        crs = _crs(file)
        for number in range(file.scan_count):
            scan = _read_scan(file, number, path, in_pieces)
            while (cloud := _next(scan, path)) is not None:
                if len(cloud):
                    yield replace(cloud, crs=crs)
    finally:
        file.close()


def _next(scan: Iterator[Cloud], path: Path) -> Cloud | None:
    with _errors_of(path):
        return next(scan, None)


def _crs(file: pye57.E57) -> str:
    """The coordinate system that the file names, as text."""
    root = file.root
    name = "coordinateMetadata"
    return str(root[name].value()).strip() if root.isDefined(name) else ""


@contextmanager
def _errors_of(path: Path) -> Iterator[None]:
    """libE57Format has its own exception, raised through pybind11."""
    try:
        yield
    except ValueError as error:
        if str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path}: damaged: {' '.join(str(error).split())[:160]}") from error
    except Exception as error:
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: truncated or not an E57 file: {message}") from error


def _read_scan(file: pye57.E57, number: int, path: Path, in_pieces: bool) -> Iterator[Cloud]:
    header = file.get_header(number)
    name = header["name"].value() if "name" in header.scan_fields else ""
    name = f"{path}: {name or f'scan {number}'}" if file.scan_count > 1 else str(path)
    tables = _read_records(file, header, f"{path}: scan {number}")
    for table in tables if in_pieces else _as_one(tables):
        yield _posed(_cloud(table, header, name, path), header, path)


def _as_one(tables: Iterator[dict[str, np.ndarray]]) -> Iterator[dict[str, np.ndarray]]:
    """The pieces of a table, at least one, together."""
    pieces = list(tables)
    yield {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _cloud(table: dict[str, np.ndarray], header: Any, name: str, path: Path) -> Cloud:
    """What one piece of a scan, or all of it, holds of valid points, in the scan's frame."""
    valid = _valid(table)
    kept = {name: values[valid] for name, values in table.items()}
    invalid = len(valid) - int(np.count_nonzero(valid))
    return Cloud(
        points_m=_places(kept, path),
        colour=_colour(kept, header),
        intensity=kept.get("intensity"),
        normals=stacked([kept[name] for name in _NORMALS]) if set(_NORMALS) <= set(kept) else None,
        columns={
            column.removeprefix(OWN_COLUMNS): values
            for column, values in kept.items()
            if column not in _HIDDEN
        },
        name=name,
        notes=(f"dropped {invalid:,} invalid of {len(valid):,} points",) if invalid else (),
    )


def _kinds(header: Any) -> dict[str, type]:
    """What each column of a scan is read as: those of the standard, and numbers of extensions."""
    from pye57 import libe57

    read_as = {
        libe57.NodeType.E57_INTEGER: np.longlong,
        libe57.NodeType.E57_SCALED_INTEGER: np.float64,
        libe57.NodeType.E57_FLOAT: np.float64,
    }
    nodes = libe57.StructureNode(header.points.prototype())
    found = {name: read_as.get(nodes.get(name).type()) for name in header.point_fields}
    return {name: kind for name, kind in (found | _KINDS).items() if kind and name in found}


def _posed(cloud: Cloud, header: Any, path: Path) -> Cloud:
    """The scan in the frame of the file, if it has a pose."""
    if not header.has_pose():
        return cloud
    T_file_scan = make_transform(header.rotation_matrix, header.translation)
    turn = T_file_scan[:3, :3]
    if not np.isfinite(T_file_scan).all() or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
        raise ValueError(f"{path}: damaged: the pose of {cloud.name} is no rigid motion")
    moved = cloud.moved(T_file_scan)
    is_moved = not np.array_equal(T_file_scan, np.eye(4))
    place_m = T_file_scan[:3, 3] if is_moved else None
    return Cloud(**{**vars(moved), "viewpoint_m": place_m})


def _read_records(file: pye57.E57, header: Any, what: str) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a scan, a piece at a time and one at least; all its rows, or an error."""
    from pye57 import libe57

    kinds = _kinds(header)
    announced = int(header.point_count)
    capacity = max(1, min(announced, RECORDS_AT_ONCE))
    arrays: dict[str, np.ndarray] = {name: np.zeros(capacity, kind) for name, kind in kinds.items()}
    buffers = libe57.VectorSourceDestBuffer()
    for name, array in arrays.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, name, array, capacity, True, True))
    reader, present = header.points.reader(buffers), 0
    while present < announced and (count := reader.read()):
        yield {name: array[:count].copy() for name, array in arrays.items()}
        present += count
    reader.close()
    if present != announced:
        raise ValueError(f"{what}: truncated: announces {announced} points, holds {present}")
    if present == 0:
        yield {name: array[:0] for name, array in arrays.items()}


def _valid(table: dict[str, np.ndarray]) -> BoolArray:
    valid = np.ones(len(next(iter(table.values()), ())), bool)
    for name in ("cartesianInvalidState", "sphericalInvalidState"):
        if name in table:
            valid &= table[name] == 0
    return valid


def _places(table: dict[str, np.ndarray], path: Path) -> FloatArray:
    if all(name in table for name in _CARTESIAN):
        return stacked([table[name] for name in _CARTESIAN])
    if not all(name in table for name in _SPHERICAL):
        raise ValueError(f"{path}: a scan has neither cartesian nor spherical coordinates")
    range_m, azimuth, elevation = (table[name] for name in _SPHERICAL)
    across_m, up_m = range_m * np.cos(elevation), range_m * np.sin(elevation)
    return stacked([across_m * np.cos(azimuth), across_m * np.sin(azimuth), up_m])


def _colour(table: dict[str, np.ndarray], header: Any) -> IntArray | None:
    if not all(name in table for name in _COLOURS):
        return None
    if all(name in table for name in _FINE):
        return stacked([table[name] for name in _FINE]).astype(np.uint16)
    colours = [table[name] for name in _COLOURS]
    if "colorLimits" not in header.scan_fields:
        return as_colour(colours)
    brightest = float(header["colorLimits"]["colorRedMaximum"].value())
    scaled = stacked(colours) * (65535 / brightest if brightest > 0 else 257)
    return np.clip(np.rint(np.nan_to_num(scaled)), 0, 65535).astype(np.uint16)
