"""PLY, ascii and binary, read straight into NumPy.

The reader is our own because the others do not fit: Open3D takes over a second to import and
reads a truncated file without an error, plyfile is GPL. A PLY body is a table of records, read by
``np.frombuffer``.
Format: G. Turk, "The PLY polygon file format", 1994.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.storage import replacing
from skipnet.types import FloatArray, IntArray

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER_LINES = 1000
_COLORS = ("red", "green", "blue")
RECORDS_AT_ONCE = 1 << 18
"""Records read or written in one go."""


@dataclass
class _Element:
    """One element of the header, such as ``vertex``: how many records and of which columns."""

    name: str
    count: int
    columns: list[tuple[str, str]] = field(default_factory=list)
    has_list: bool = False


def read_ply(path: Path) -> Iterator[FloatArray]:
    """The vertices of a PLY file, chunk by chunk.

    Args:
        path: of an ascii, little-endian or big-endian PLY file. Other columns and elements
            are skipped.

    Yields:
        (n, 3) float64 points; an ascii file's all at once.

    Raises:
        ValueError: it is not a PLY file, has no vertices, or ends before its last vertex.
    """
    with open(path, "rb") as file:
        format_name, elements = _read_header(file, path)
        order = _BYTE_ORDERS[format_name]
        for element in elements:
            if element.has_list:
                raise ValueError(f"{path}: lists before or in the vertices are not supported")
            dtype = np.dtype([(name, order + kind) for name, kind in element.columns])
            if element.name == "vertex":
                if format_name == "ascii":
                    yield _read_ascii(file, element, path)
                else:
                    yield from _read_binary(file, element, dtype, path)
                return
            if format_name == "ascii":
                _read_ascii(file, element, path)
            else:
                file.seek(element.count * dtype.itemsize, 1)
    raise ValueError(f"{path}: has no vertices: expected a PLY file with an element 'vertex'")


def _read_header(file: BinaryIO, path: Path) -> tuple[str, list[_Element]]:
    """The format's name and the elements up to ``vertex``."""
    if file.readline(16).strip() != b"ply":
        raise ValueError(f"{path}: not a PLY file: its first line is not 'ply'")
    format_name, elements = "", []
    for _ in range(_LONGEST_HEADER_LINES):
        words = file.readline(4096).decode("ascii", "replace").split()
        if words == ["end_header"]:
            break
        if words[:1] == ["format"] and len(words) == 3:
            format_name = words[1]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append(_Element(words[1], int(words[2])))
        elif words[:1] == ["property"] and elements:
            _add_property(elements[-1], words, path)
    else:
        raise ValueError(f"{path}: truncated or not a PLY file: its header never ends")
    if format_name not in _BYTE_ORDERS:
        raise ValueError(
            f"{path}: unknown PLY format {format_name!r}: expected one of {list(_BYTE_ORDERS)}"
        )
    return format_name, elements


def _add_property(element: _Element, words: list[str], path: Path) -> None:
    if words[1:2] == ["list"]:
        element.has_list = True
    elif len(words) == 3 and words[1] in _TYPES:
        element.columns.append((words[2], _TYPES[words[1]]))
    else:
        raise ValueError(f"{path}: cannot read the header line {' '.join(words)!r}")


def _xyz_columns(element: _Element, path: Path) -> list[int]:
    names = [name for name, _ in element.columns]
    if element.name == "vertex" and not {"x", "y", "z"} <= set(names):
        raise ValueError(
            f"{path}: its vertices lack x, y or z: they have {', '.join(names) or 'nothing'}"
        )
    return [names.index(axis) for axis in "xyz"] if element.name == "vertex" else []


def _read_binary(
    file: BinaryIO, element: _Element, dtype: np.dtype, path: Path
) -> Iterator[FloatArray]:
    names = [element.columns[column][0] for column in _xyz_columns(element, path)]
    for start in range(0, element.count, RECORDS_AT_ONCE):
        wanted = min(RECORDS_AT_ONCE, element.count - start)
        body = file.read(wanted * dtype.itemsize)
        if len(body) < wanted * dtype.itemsize:
            raise _truncated(path, start + len(body) // dtype.itemsize, element)
        table = np.frombuffer(body, dtype)
        points = np.empty((wanted, 3))
        for axis, name in enumerate(names):
            points[:, axis] = table[name]
        yield points


def _read_ascii(file: BinaryIO, element: _Element, path: Path) -> FloatArray:
    columns = _xyz_columns(element, path)
    lines = list(islice(file, element.count))
    if len(lines) < element.count:
        raise _truncated(path, len(lines), element)
    if not columns or not lines:
        return np.empty((0, 3))
    try:
        return np.loadtxt(lines, usecols=columns, ndmin=2)
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: truncated or damaged vertices: {error}") from error


def _truncated(path: Path, present: int, element: _Element) -> ValueError:
    return ValueError(
        f"{path}: truncated: its header announces {element.count} records of {element.name!r}, "
        f"the file holds {present}; copy or export it again"
    )


def write_ply(path: Path | str, points: FloatArray, colors: IntArray | None = None) -> None:
    """Write a binary PLY file, whole or not at all.

    Args:
        path: of the file; an existing one is replaced.
        points: (N, 3) points, written as float64: surveyed coordinates run into millions of metres.
        colors: (N, 3) red, green, blue in 0..255, or None.
    """
    starts = range(0, len(points), RECORDS_AT_ONCE)
    pieces = [slice(start, start + RECORDS_AT_ONCE) for start in starts]
    points, colors = np.asarray(points), None if colors is None else np.asarray(colors)
    tables = (
        _vertices(points[piece], None if colors is None else colors[piece]) for piece in pieces
    )
    _write_tables(path, tables, colors is not None)


def write_ply_chunks(path: Path | str, chunks: Iterable[FloatArray]) -> None:
    """As ``write_ply``, for (n, 3) chunks of points that are never in memory all at once."""
    _write_tables(path, (_vertices(chunk, None) for chunk in chunks), False)


def _vertices(points: FloatArray, colors: IntArray | None) -> np.ndarray:
    """Records as they stand in the file."""
    table = np.empty(len(points), dtype=_columns(colors is not None))
    for index, axis in enumerate("xyz"):
        table[axis] = points[:, index]
    for index, name in enumerate(_COLORS if colors is not None else ()):
        table[name] = colors[:, index]  # type: ignore[index]
    return table


def _columns(coloured: bool) -> list[tuple[str, str]]:
    return [(axis, "<f8") for axis in "xyz"] + [(name, "u1") for name in _COLORS if coloured]


def _write_tables(path: Path | str, tables: Iterable[np.ndarray], coloured: bool) -> None:
    count = 0
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write(_header(count, coloured))
        for table in tables:
            table.tofile(file)
            count += len(table)
        file.seek(0)
        file.write(_header(count, coloured))


def _header(count: int, coloured: bool) -> bytes:
    """The head of a file of ``count`` vertices; always of one length, so it can be written anew."""
    kinds = {"<f8": "double", "u1": "uchar"}
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in _columns(coloured))
    vertices = f"element vertex {count:<12}\n{properties}"
    return f"ply\nformat binary_little_endian 1.0\n{vertices}end_header\n".encode("ascii")
