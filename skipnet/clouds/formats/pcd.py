"""PCD, the Point Cloud Library's format: ascii, binary and compressed.

The reader is our own: Open3D's leaves memory uninitialised where a header promises what the body
does not hold, reads 8-byte coordinates as zeros and loses the viewpoint.
Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html, version 0.7.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats.columns import (
    cloud_of_columns,
    columns_in_8_bits,
    has_fine_colours,
)
from skipnet.clouds.formats.lzf import LARGEST_RATIO, decompress
from skipnet.clouds.formats.pcd_header import PcdHeader, read_header
from skipnet.storage import replacing
from skipnet.types import FloatArray, IntArray

_PACKED = ("rgb", "rgba")
RECORDS_AT_ONCE = 1 << 18
"""Records of a binary file read in one go."""


def read_pcd(path: Path) -> Iterator[Cloud]:
    """The points of a PCD file with all its fields of one number each, and its viewpoint.

    Raises:
        ValueError: it is not a PCD file, lacks x, y or z, or ends before its last point.
    """
    with open(path, "rb") as file:
        header = read_header(file, path)
        read = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
        for fields in read[header.encoding](file, header, path):
            yield _cloud(fields, header, path)


def _cloud(fields: list[np.ndarray], header: PcdHeader, path: Path) -> Cloud:
    table: dict[str, np.ndarray] = {}
    for name, count, values in zip(header.names, header.counts, fields, strict=True):
        if name.lower() in _PACKED and count == 1 and values.dtype.itemsize == 4:
            table |= _unpacked(values[:, 0])
        elif count == 1 and name != "_" and name not in table:
            table[name] = values[:, 0]
    return cloud_of_columns(table, path, viewpoint_m=header.viewpoint_m)


def _unpacked(values: np.ndarray) -> dict[str, IntArray]:
    """Red, green and blue of numbers that hold them in their bytes."""
    bits = np.ascontiguousarray(values).view(np.uint32)
    shifts = {"red": 16, "green": 8, "blue": 0}
    return {name: (bits >> shift & 255).astype(np.uint8) for name, shift in shifts.items()}


def _ascii(file: BinaryIO, header: PcdHeader, path: Path) -> Iterator[list[np.ndarray]]:
    lines = file.read().splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    _check_count(len(lines), header, path)
    try:
        rows = np.loadtxt(lines, ndmin=2, comments=None) if lines else np.empty((0, 0))
    except ValueError as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: truncated or damaged points: {message}") from error
    width = sum(header.counts)
    if len(rows) < header.points or (len(rows) and rows.shape[1] != width):
        raise ValueError(f"{path}: damaged points: expected {width} numbers in every line")
    ends = np.cumsum(header.counts)
    columns = np.split(rows if len(rows) else np.empty((0, width)), ends[:-1], axis=1)
    yield [
        _retyped(values, kind, name.lower() in _PACKED)
        for values, kind, name in zip(columns, header.kinds, header.names, strict=True)
    ]


def _retyped(values: FloatArray, kind: str, is_packed: bool) -> np.ndarray:
    """As the field's own kind, where that keeps the values: the text may have more digits."""
    if kind[0] == "f":
        return values.astype(kind) if is_packed else values
    limits = np.iinfo(kind)
    fits = np.isfinite(values).all() and (
        values.size == 0 or (values.min() >= limits.min and values.max() <= limits.max)
    )
    return values.astype(kind) if fits else values


def _check_count(present: int, header: PcdHeader, path: Path) -> None:
    if present != header.points:
        raise ValueError(
            f"{path}: truncated or damaged: its header announces {header.points} points, "
            f"it holds {present}"
        )


def _left(file: BinaryIO) -> int:
    return os.fstat(file.fileno()).st_size - file.tell()


def _binary(file: BinaryIO, header: PcdHeader, path: Path) -> Iterator[list[np.ndarray]]:
    dtype = header.dtype
    if _left(file) < header.points * dtype.itemsize:
        _check_count(_left(file) // dtype.itemsize, header, path)
    for start in range(0, header.points, RECORDS_AT_ONCE):
        wanted = min(RECORDS_AT_ONCE, header.points - start)
        records = np.frombuffer(file.read(wanted * dtype.itemsize), dtype, wanted)
        yield [records[name] for name in dtype.names or ()]


def _compressed(file: BinaryIO, header: PcdHeader, path: Path) -> Iterator[list[np.ndarray]]:
    """Bytes packed by LZF; unpacked, one field stands after the other."""
    dtype = header.dtype
    sizes = np.frombuffer(file.read(8).ljust(8, b"\0"), "<u4").astype(np.int64)
    packed, unpacked = int(sizes[0]), int(sizes[1])
    if packed > _left(file):
        raise ValueError(f"{path}: truncated: {packed} bytes of points announced")
    if unpacked != header.points * dtype.itemsize or unpacked > LARGEST_RATIO * packed:
        raise ValueError(
            f"{path}: damaged: {packed} bytes cannot hold {header.points} compressed points"
        )
    content = decompress(np.frombuffer(file.read(packed), np.uint8), unpacked)
    if content is None:
        raise ValueError(f"{path}: damaged: its compressed points cannot be unpacked")
    fields, start = [], 0
    for kind, count in zip(header.kinds, header.counts, strict=True):
        size = header.points * count * np.dtype(kind).itemsize
        values = content[start : start + size].view(f"<{kind}")
        fields.append(values.reshape(header.points, count))
        start += size
    yield fields


def write_pcd(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write a cloud as a binary PCD file, whole or not at all, coordinates as doubles."""
    cloud = concatenate(list(clouds))
    table = columns_in_8_bits(cloud, has_fine_colours(cloud))
    if cloud.colour is not None:
        red, green, blue = (table.pop(name).astype(np.uint32) for name in ("red", "green", "blue"))
        table["rgb"] = (red << 16 | green << 8 | blue).view(np.float32)
    if cloud.normals is not None:
        renamed = {"nx": "normal_x", "ny": "normal_y", "nz": "normal_z"}
        table = {renamed.get(name, name): values for name, values in table.items()}
    kinds = [
        values.dtype.str[1:] if values.dtype.kind in "iuf" else "f8" for values in table.values()
    ]
    names = [name.replace(" ", "_") for name in table]
    records = np.empty(
        len(cloud), [(name, f"<{kind}") for name, kind in zip(names, kinds, strict=True)]
    )
    for name, values in zip(names, table.values(), strict=True):
        records[name] = values
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write(_written_header(names, kinds, cloud))
        records.tofile(file)


def _written_header(names: list[str], kinds: list[str], cloud: Cloud) -> bytes:
    place = np.zeros(3) if cloud.viewpoint_m is None else cloud.viewpoint_m
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(kind[1:] for kind in kinds),
        "TYPE": " ".join(kind[0].upper() for kind in kinds),
        "COUNT": " ".join("1" for _ in names),
        "WIDTH": str(len(cloud)),
        "HEIGHT": "1",
        "VIEWPOINT": " ".join(f"{coordinate:.9g}" for coordinate in place) + " 1 0 0 0",
        "POINTS": str(len(cloud)),
        "DATA": "binary",
    }
    return "".join(f"{keyword} {words}\n" for keyword, words in lines.items()).encode()
