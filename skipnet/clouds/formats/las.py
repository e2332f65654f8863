"""LAS and LAZ files, through laspy, a piece at a time.

What the library would believe of a damaged header is held against the file first: a false number
of chunks ends the process in its decompressor, a false number of records keeps it for ever.
Format: ASPRS, LAS specification 1.4.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from skipnet.checks import METRES_PER_UNIT, missing_package
from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats.columns import cloud_of_columns, stacked
from skipnet.storage import replacing

if TYPE_CHECKING:
    import laspy

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_VLR_BYTES, _EVLR_BYTES = 54, 60
_SHORTEST_HEADER, _LONGEST_RECORD = 227, 1 << 12
_SCALE_M = 1e-4
"""Of what is written: a tenth of a millimetre reaches 200 km about the offset."""


def read_las(path: Path) -> Iterator[Cloud]:
    """The points of a LAS or LAZ file with colour, intensity and every other dimension.

    Raises:
        ValueError: it is damaged or ends before its last point.
    """
    try:
        import laspy
    except ModuleNotFoundError as error:
        raise missing_package(path, "laspy") from error
    _check_sizes(path)
    present = 0
    try:
        with laspy.open(path) as file:
            header = file.header
            crs = _crs(header)
            for records in file.chunk_iterator(RECORDS_AT_ONCE):
                present += len(records)
                yield _cloud(records, header, crs, path)
    except (KeyboardInterrupt, SystemExit, MemoryError, GeneratorExit):
        raise
    except BaseException as error:  # a panic of the decompressor is no Exception
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: truncated or not a LAS/LAZ file: {message}") from error
    if present != header.point_count:
        raise ValueError(
            f"{path}: truncated: its header announces {header.point_count} points, "
            f"it holds {present}"
        )


def _cloud(records: Any, header: laspy.LasHeader, crs: str, path: Path) -> Cloud:
    # Scaled by hand: the chunk's own x, y, z would make three more copies.
    raw = stacked([records.X, records.Y, records.Z])
    table = dict(zip("xyz", (raw * header.scales + header.offsets).T, strict=True))
    for name in records.point_format.dimension_names:
        values = np.asarray(records[name])
        if name not in ("X", "Y", "Z") and values.any():
            table[name] = values
    return cloud_of_columns(table, path, offset_m=np.array(header.offsets), crs=crs)


def _crs(header: laspy.LasHeader) -> str:
    """The text of the coordinate system's record, if there is one."""
    for record in header.vlrs:
        text = getattr(record, "string", None)
        if record.user_id == "LASF_Projection" and record.record_id == 2112 and text:
            return str(text).strip("\0 ")
    return ""


def _check_sizes(path: Path) -> None:
    """Hold what the header announces against the file's size."""
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(375).ljust(375, b"\0")
        if head[:4] != b"LASF":
            raise ValueError(f"{path}: not a LAS/LAZ file: it does not begin with LASF")
        header_bytes, points_at, vlrs = struct.unpack_from("<HII", head, 94)
        kind, record_bytes, count = struct.unpack_from("<BHI", head, 104)
        version = head[24], head[25]
        if version >= (1, 4):
            evlrs_at, evlrs, count = struct.unpack_from("<QIQ", head, 235)
            _require(evlrs == 0 or evlrs_at + evlrs * _EVLR_BYTES <= size, "extended records", path)
        _require(_SHORTEST_HEADER <= header_bytes <= points_at <= size, "header", path)
        _require(header_bytes + vlrs * _VLR_BYTES <= points_at, "variable-length records", path)
        _require(0 < record_bytes < _LONGEST_RECORD, "record length", path)
        if kind & 0x80:
            _check_chunks(file, points_at, record_bytes, size, path)
        else:
            held = (size - points_at) // record_bytes
            if held < count:
                raise ValueError(
                    f"{path}: truncated: its header announces {count} points, it holds {held}"
                )


def _check_chunks(file: BinaryIO, points_at: int, record_bytes: int, size: int, path: Path) -> None:
    """Of a compressed file: where its table of chunks stands, and how many it can have."""
    file.seek(points_at)
    (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
    if table_at == -1:  # written to a stream: the place stands at the file's end
        file.seek(max(0, size - 8))
        (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
    _require(points_at + 8 <= table_at <= size - 8, "table of chunks", path)
    file.seek(table_at + 4)
    (chunks,) = struct.unpack("<I", file.read(4))
    # Every chunk begins with one record that is not compressed.
    _require(chunks * record_bytes <= table_at - points_at, "number of chunks", path)


def _require(fits: bool, what: str, path: Path) -> None:
    if not fits:
        raise ValueError(f"{path}: truncated or damaged: its {what} cannot be right for its size")


def write_las(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write LAS 1.4, or LAZ if the path says so, whole or not at all.

    Coordinates are whole tenths of a millimetre from the cloud's offset. Columns keep their names;
    those that the point format lacks become extra dimensions.
    """
    import laspy

    cloud = concatenate(list(clouds))
    per_unit = METRES_PER_UNIT[cloud.unit]
    header = laspy.LasHeader(version="1.4", point_format=6 if cloud.colour is None else 7)
    points = cloud.points_m / per_unit
    header.scales = np.full(3, _SCALE_M / per_unit)
    header.offsets = _offset(points, cloud.offset_m / per_unit)
    _add_dimensions(header, cloud)
    if cloud.crs:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(cloud.crs))
        header.global_encoding.wkt = True
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    _fill(las, cloud)
    with replacing(path) as temporary:
        las.write(str(temporary))


def _offset(points: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """The offset of the cloud, or a whole one near its points, if these lie too far from it."""
    reach = np.abs(points - offset).max(initial=0)
    return offset if reach * 1e4 < 2**31 else np.round(points.mean(axis=0))


def _add_dimensions(header: laspy.LasHeader, cloud: Cloud) -> None:
    import laspy

    known = set(header.point_format.dimension_names)
    for name, values in _extra(cloud).items():
        if name not in known:
            kind = values.dtype if values.dtype.kind in "iuf" else np.dtype(np.float64)
            header.add_extra_dim(laspy.ExtraBytesParams(name=name[:32], type=kind))


def _extra(cloud: Cloud) -> dict[str, np.ndarray]:
    """Columns, and normals, which LAS has no place for."""
    normals = (
        {} if cloud.normals is None else dict(zip(("nx", "ny", "nz"), cloud.normals.T, strict=True))
    )
    return {**normals, **cloud.columns}


def _fill(las: laspy.LasData, cloud: Cloud) -> None:
    if cloud.colour is not None:
        las.red, las.green, las.blue = cloud.colour.T.astype(np.uint16) * 257
    if cloud.intensity is not None:
        las.intensity = _as_16_bits(cloud.intensity)
    for name, values in _extra(cloud).items():
        las[name[:32]] = values


def _as_16_bits(intensity: np.ndarray) -> np.ndarray:
    """Intensities as LAS has them: whole numbers up to 65535; those from 0 to 1 are scaled."""
    values = np.nan_to_num(np.asarray(intensity, np.float64))
    if values.max(initial=0) <= 1:
        values = values * 65535
    return np.clip(np.rint(values), 0, 65535).astype(np.uint16)
