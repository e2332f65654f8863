"""LAS and LAZ files, through laspy, a piece at a time.

Format: ASPRS, LAS specification 1.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.checks import METRES_PER_UNIT, missing_package
from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats.columns import cloud_of_columns, stacked, take_intensity
from skipnet.clouds.formats.coordinate_systems import DEGREES, unit_of_geokeys, unit_of_wkt
from skipnet.clouds.formats.las_sizes import check_sizes
from skipnet.clouds.formats.panics import without_trace
from skipnet.storage import replacing

if TYPE_CHECKING:
    import laspy

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_FEW_DEGREES = 0.5
"""A site is smaller; a scan in metres that is labelled wrongly, as many are, is larger."""
_SCALE_M = 1e-4
"""Of what is written: a tenth of a millimetre reaches 200 km about the offset."""

_PLACE_RECORD = "skipnet", 1
"""User and number of the variable-length record with the sensor's place."""


def read_las(path: Path) -> Iterator[Cloud]:
    """The points of a LAS or LAZ file with colour, intensity and every other dimension.

    Raises:
        ValueError: it is damaged or ends before its last point.
    """
    try:
        import laspy
    except ModuleNotFoundError as error:
        raise missing_package(path, "laspy") from error
    check_sizes(path)
    present = 0
    try:
        # In one thread: the parallel decompressor takes as much memory as a damaged file asks for.
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
            header = file.header
            crs = _crs(header)
            unit = _unit(header, crs, path)
            pieces = iter(file.chunk_iterator(RECORDS_AT_ONCE))
            while (records := _next(pieces)) is not None:
                present += len(records)
                yield _cloud(records, header, crs, unit, path)
    except (KeyboardInterrupt, SystemExit, MemoryError, GeneratorExit):
        raise
    except ValueError as error:
        if str(error).startswith(str(path)):
            raise
        raise ValueError(f"{path}: damaged: {' '.join(str(error).split())[:160]}") from error
    except BaseException as error:  # a panic of the decompressor is no Exception
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: truncated or not a LAS/LAZ file: {message}") from error
    if present != header.point_count:
        raise ValueError(
            f"{path}: truncated: its header announces {header.point_count} points, "
            f"it holds {present}"
        )


def _next(pieces: Iterator[Any]) -> Any:
    with without_trace():
        return next(pieces, None)


def _cloud(records: Any, header: laspy.LasHeader, crs: str, unit: str, path: Path) -> Cloud:
    # Scaled by hand: the chunk's own x, y, z would make three more copies.
    raw = stacked([records.X, records.Y, records.Z])
    table = dict(zip("xyz", (raw * header.scales + header.offsets).T, strict=True))
    for name in records.point_format.dimension_names:
        values = np.asarray(records[name])
        if name in ("X", "Y", "Z"):
            continue
        if values.ndim == 1 and not values.any():  # unused here, perhaps not in the next piece
            table[name] = np.broadcast_to(values.dtype.type(0), len(values))
        elif values.ndim == 1:
            table[name] = values
        else:
            table |= {f"{name} {k}": column for k, column in enumerate(values.T)}
    offset_m = np.array(header.offsets) * METRES_PER_UNIT[unit]
    cloud = cloud_of_columns(table, path, unit, offset_m=offset_m, crs=crs)
    # As 16 bits, so that a writer knows without having seen them all that none is beyond.
    intensity = None if cloud.intensity is None else cloud.intensity.astype(np.uint16)
    return replace(cloud, viewpoint_m=_place_m(header), intensity=intensity)


def without_unused(pieces: Sequence[Cloud]) -> list[Cloud]:
    """The pieces of a file without the dimensions that are zero in all of them: a point format has
    some twenty, of which few are used."""
    used = {name for piece in pieces for name, values in piece.columns.items() if values.any()}
    has_colour, has_intensity = (
        any(values is not None and values.any() for values in column)
        for column in ([piece.colour for piece in pieces], [piece.intensity for piece in pieces])
    )
    kept = []
    for piece in pieces:
        columns = {name: values for name, values in piece.columns.items() if name in used}
        intensity = piece.intensity if has_intensity else take_intensity(columns)
        colour = piece.colour if has_colour else None
        kept.append(replace(piece, colour=colour, intensity=intensity, columns=columns))
    return kept


def _place_m(header: laspy.LasHeader) -> np.ndarray | None:
    """(3,) the sensor's place, in metres, as our own files keep it; the format has no word for
    it."""
    for record in header.vlrs:
        if (record.user_id, record.record_id) == _PLACE_RECORD:
            data = record.record_data_bytes()
            if len(data) == 24 and np.isfinite(np.frombuffer(data, "<f8")).all():
                return np.frombuffer(data, "<f8").copy()
    return None


def _crs(header: laspy.LasHeader) -> str:
    """The text of the coordinate system's record, if there is one."""
    for record in header.vlrs:
        text = getattr(record, "string", None)
        if record.user_id == "LASF_Projection" and record.record_id == 2112 and text:
            return str(text).strip("\0 ")
    return ""


def _unit(header: laspy.LasHeader, crs: str, path: Path) -> str:
    """The unit that the coordinate system names; degrees only where the points can be such."""
    keys = [
        record.record_data_bytes()
        for record in header.vlrs
        if record.user_id == "LASF_Projection" and record.record_id == 34735
    ]
    unit = unit_of_wkt(crs) if crs else unit_of_geokeys(keys[0]) if keys else "m"
    if unit != DEGREES:
        return unit
    if np.ptp([header.mins, header.maxs], axis=0)[:2].max() < _FEW_DEGREES:
        raise ValueError(
            f"{path}: its coordinates are degrees of longitude and latitude: project them to "
            "metres first"
        )
    return "m"


def write_las(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write pieces of one cloud as LAS 1.4, or LAZ if the path says so, whole or not at all.

    Coordinates are whole tenths of a millimetre from the cloud's offset. Columns keep their names;
    those that the point format lacks become extra dimensions. What the first piece holds the file
    has room for; only where intensities must be scaled, by all of them, are all pieces in memory.
    """
    import laspy

    pieces = iter(clouds)
    first = next(pieces)
    if first.intensity is not None and first.intensity.dtype.kind not in "iu":
        first, pieces = concatenate([first, *pieces]), iter(())
    header = _header_of(first)
    with (
        replacing(path) as temporary,
        laspy.open(
            str(temporary), mode="w", header=header, do_compress=path.suffix.lower() == ".laz"
        ) as file,
    ):
        for piece in chain([first], pieces):
            file.write_points(_records_of(piece, header))


def _header_of(cloud: Cloud) -> laspy.LasHeader:
    import laspy

    per_unit = METRES_PER_UNIT[cloud.unit]
    header = laspy.LasHeader(version="1.4", point_format=6 if cloud.colour is None else 7)
    header.scales = np.full(3, _SCALE_M / per_unit)
    header.offsets = _offset(cloud.points_m / per_unit, cloud.offset_m / per_unit)
    _add_dimensions(header, cloud)
    if cloud.crs:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(cloud.crs))
        header.global_encoding.wkt = True
    if cloud.viewpoint_m is not None:
        data = np.asarray(cloud.viewpoint_m, "<f8").tobytes()
        header.vlrs.append(laspy.VLR(*_PLACE_RECORD, "sensor's place, metres", data))
    return header


def _records_of(cloud: Cloud, header: laspy.LasHeader) -> Any:
    import laspy

    records = laspy.ScaleAwarePointRecord.zeros(len(cloud), header=header)
    records.x, records.y, records.z = (cloud.points_m / METRES_PER_UNIT[cloud.unit]).T
    if cloud.colour is not None and "red" in header.point_format.dimension_names:
        fine = cloud.colour.dtype == np.uint16
        for name, values in zip(("red", "green", "blue"), cloud.colour.T, strict=True):
            records[name] = values.astype(np.uint16) * (1 if fine else 257)
    if cloud.intensity is not None:
        records["intensity"] = _as_16_bits(cloud.intensity)
    present = set(header.point_format.dimension_names)
    for name, values in _extra(cloud).items():
        if name[:32] in present:
            records[name[:32]] = values
    return records


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


def _as_16_bits(intensity: np.ndarray) -> np.ndarray:
    """Intensities as LAS has them: whole numbers up to 65535; those from 0 to 1 are scaled, and
    where some are negative, as those of PTS are, all are counted from the smallest."""
    values = np.nan_to_num(np.asarray(intensity, np.float64))
    values = values - min(values.min(initial=0), 0)
    if values.max(initial=0) <= 1:
        values = values * 65535
    return np.clip(np.rint(values), 0, 65535).astype(np.uint16)
