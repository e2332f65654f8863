"""What a LAS or LAZ header announces, held against the file before a library believes it.

A false number of chunks ends the process in the decompressor, a false length of a layer makes it
take all memory, a false number of records keeps the reader for ever.
Format: ASPRS, LAS specification 1.4; M. Isenburg, LASzip, its layered chunks.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

_VLR_BYTES, _EVLR_BYTES = 54, 60
_SHORTEST_HEADER, _LONGEST_RECORD = 227, 1 << 12
_LAYERED = {6: (30, 9), 7: (36, 10), 8: (38, 11), 9: (59, 10), 10: (67, 12)}
"""Bytes of a record and layers of a chunk of each layered format, without extra bytes, each of
which is a layer of its own."""


@dataclass(frozen=True)
class _Head:
    size: int
    """Of the file."""
    points_at: int
    kind: int
    """Format of the points, with LAZ's mark."""
    record_bytes: int
    points: int


def check_sizes(path: Path) -> None:
    """Refuse a file whose header promises what cannot be in it.

    Raises:
        ValueError: it is truncated, damaged or no LAS file.
    """
    with open(path, "rb") as file:
        head = _read_head(file, path)
        if head.kind & 0x80:
            _check_chunks(file, head, path)
            return
        held = (head.size - head.points_at) // head.record_bytes
        if held < head.points:
            raise ValueError(
                f"{path}: truncated: its header announces {head.points} points, it holds {held}"
            )


def unpacked_bytes(path: Path) -> int:
    """What the points of a file that its compressor may have packed take, as the header says.

    Raises:
        ValueError: its header is damaged, or it is no LAS file.
    """
    with open(path, "rb") as file:
        head = _read_head(file, path)
    return head.points * head.record_bytes


def _read_head(file: BinaryIO, path: Path) -> _Head:
    size = os.fstat(file.fileno()).st_size
    head = file.read(375).ljust(375, b"\0")
    if head[:4] != b"LASF":
        raise ValueError(f"{path}: not a LAS/LAZ file: it does not begin with LASF")
    header_bytes, points_at, vlrs = struct.unpack_from("<HII", head, 94)
    kind, record_bytes, count = struct.unpack_from("<BHI", head, 104)
    if (head[24], head[25]) >= (1, 4):
        evlrs_at, evlrs, count = struct.unpack_from("<QIQ", head, 235)
        _check_extended(file, evlrs_at, evlrs, size, path)
    _require(_SHORTEST_HEADER <= header_bytes <= points_at <= size, "header", path)
    _require(header_bytes + vlrs * _VLR_BYTES <= points_at, "variable-length records", path)
    _require(0 < record_bytes < _LONGEST_RECORD, "record length", path)
    return _Head(size, points_at, kind, record_bytes, count)


def _check_extended(file: BinaryIO, at: int, records: int, size: int, path: Path) -> None:
    """The extended records behind the points: each says how long it is."""
    _require(records * _EVLR_BYTES <= size, "extended records", path)
    for _ in range(records):
        _require(at + _EVLR_BYTES <= size, "extended records", path)
        file.seek(at + 20)
        at += _EVLR_BYTES + struct.unpack("<Q", file.read(8))[0]
        _require(at <= size, "extended records", path)


def _check_chunks(file: BinaryIO, head: _Head, path: Path) -> None:
    """Of a compressed file: where its table of chunks stands, and how many it can have."""
    file.seek(head.points_at)
    (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
    if table_at == -1:  # written to a stream: the place stands at the file's end
        file.seek(max(0, head.size - 8))
        (table_at,) = struct.unpack("<q", file.read(8).ljust(8, b"\0"))
    if not head.points_at + 8 <= table_at <= head.size - 8:
        raise ValueError(
            f"{path}: truncated or damaged, or of a LASzip before 2.0: it has no table of chunks; "
            "save it again with a newer program"
        )
    file.seek(table_at + 4)
    (chunks,) = struct.unpack("<I", file.read(4))
    # Every chunk begins with one record that is not compressed.
    fits = chunks * head.record_bytes <= table_at - head.points_at
    _require(fits and (chunks > 0 or head.points == 0), "number of chunks", path)
    kind = head.kind & 0x3F
    if kind in _LAYERED:
        record_bytes, layers = _LAYERED[kind]
        layers += head.record_bytes - record_bytes
        _require(layers > 0, "record length", path)
        _check_layers(file, head, chunks, layers, table_at, path)


def _check_layers(
    file: BinaryIO, head: _Head, chunks: int, layers: int, table_at: int, path: Path
) -> None:
    """A chunk: a record, the number of points, the length of every layer, the layers."""
    at = head.points_at + 8
    for _ in range(chunks):
        file.seek(at + head.record_bytes)
        body = file.read(4 + 4 * layers)
        _require(len(body) == 4 + 4 * layers, "chunks", path)
        lengths = struct.unpack(f"<{layers + 1}I", body)[1:]
        at += head.record_bytes + len(body) + sum(lengths)
        _require(at <= table_at, "chunks", path)


def _require(fits: bool, what: str, path: Path) -> None:
    if not fits:
        raise ValueError(f"{path}: truncated or damaged: its {what} cannot be right for its size")
