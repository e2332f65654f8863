"""PLY, ascii and binary, with whatever columns it has, read straight into NumPy.

The reader is our own because the others do not fit: Open3D takes over a second to import and
reads a truncated file without an error, plyfile is GPL. A PLY body is a table of records, read by
``np.frombuffer``.
Format: G. Turk, "The PLY polygon file format", 1994.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import (
    cloud_of_columns,
    columns_in_8_bits,
    has_fine_colours,
)
from skipnet.clouds.formats.lists import read_ascii, read_binary
from skipnet.clouds.formats.ply_header import Element, read_header, remarks_on
from skipnet.clouds.formats.sampling import is_coarse, sample_triangles
from skipnet.storage import replacing
from skipnet.types import IntArray

_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "u2": "ushort"}
_NAMES |= {"i2": "short", "u4": "uint", "i4": "int"}
_FACES = ("vertex_indices", "vertex_index")
RECORDS_AT_ONCE = 1 << 18
"""Records read or written in one go."""


def read_ply(path: Path) -> Iterator[Cloud]:
    """The vertices of a PLY file, piece by piece; a mesh of few vertices is sampled.

    Raises:
        ValueError: it is not a PLY file, has no vertices, or ends before its last vertex.
    """
    with open(path, "rb") as file:
        header = read_header(file, path)
        order, elements, unit = header.order, header.elements, header.unit
        names = [element.name for element in elements]
        if "vertex" not in names:
            raise ValueError(
                f"{path}: has no vertices: expected a PLY file with an element 'vertex'"
            )
        vertex = elements[names.index("vertex")]
        mesh = vertex.count and is_coarse(vertex.count) and "face" in names
        if mesh and elements[names.index("face")].count:
            yield header.completes(_sampled(file, elements, order, unit, path))
            return
        for element in elements[: names.index("vertex")]:
            for _ in _pieces(file, element, order, path):
                pass
        for table in _pieces(file, vertex, order, path):
            yield header.completes(cloud_of_columns(table, path, unit, notes=_notes(vertex)))


def _notes(vertex: Element) -> tuple[str, ...]:
    left_out = ", ".join(vertex.lists)
    return (f"lists of its vertices left out: {left_out}",) if left_out else ()


def _sampled(file: BinaryIO, elements: list[Element], order: str, unit: str, path: Path) -> Cloud:
    """Points on the faces of a mesh."""
    vertices, faces = {}, []
    for element in elements:
        for table in _pieces(file, element, order, path, keep_lists=element.name == "face"):
            if element.name == "vertex":
                vertices = table
            elif element.name == "face":
                faces += _polygons(table, path)
    cloud = cloud_of_columns(vertices, path, unit)
    return sample_triangles(cloud, _triangles(faces, len(cloud), path))


def _polygons(table: Mapping[str, object], path: Path) -> list[IntArray]:
    name = next((name for name in _FACES if name in table), None)
    if name is None:
        raise ValueError(f"{path}: its faces have no list called vertex_indices")
    return list(table[name])  # type: ignore[call-overload]


def _triangles(polygons: list[IntArray], count: int, path: Path) -> IntArray:
    """(T, 3) fans of polygons."""
    fans = [
        [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
        for corners in polygons
    ]
    triangles = np.array([triangle for fan in fans for triangle in fan], np.int64).reshape(-1, 3)
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= count):
        raise ValueError(f"{path}: damaged: a face names a vertex that does not exist")
    return triangles


def _pieces(
    file: BinaryIO, element: Element, order: str, path: Path, keep_lists: bool = False
) -> Iterator[dict[str, np.ndarray]]:
    """The records of an element, a piece at a time; at least one piece."""
    read = read_binary if order else read_ascii
    for start in range(0, max(element.count, 1), RECORDS_AT_ONCE):
        wanted = min(RECORDS_AT_ONCE, element.count - start)
        present, table = read(file, element.columns, element.lists, order, wanted, path)
        if present < wanted:
            raise ValueError(
                f"{path}: truncated: its header announces {element.count} records of "
                f"{element.name!r}, the file holds {start + present}; copy or export it again"
            )
        yield {name: table[name] for name in table if keep_lists or name not in element.lists}


def write_ply(path: Path, clouds: Iterable[Cloud]) -> None:
    """Write pieces of one cloud as a binary PLY file, whole or not at all, coordinates as doubles.

    All pieces have the columns of the first.
    """
    count, kinds, remarks, is_fine = 0, [(axis, "f8") for axis in "xyz"], "", False
    with replacing(path) as temporary, open(temporary, "wb") as file:
        for cloud in clouds:
            if not count:
                is_fine = has_fine_colours(cloud)
            table = columns_in_8_bits(cloud, is_fine)
            if not count:
                kinds = [(name.replace(" ", "_"), _kind(table[name])) for name in table]
                remarks = remarks_on(cloud)
                file.write(_header(count, kinds, remarks))
            records = np.empty(len(cloud), [(name, f"<{kind}") for name, kind in kinds])
            for (name, _), values in zip(kinds, table.values(), strict=True):
                records[name] = values
            records.tofile(file)
            count += len(cloud)
        file.seek(0)
        file.write(_header(count, kinds, remarks))


def _kind(values: np.ndarray) -> str:
    """The PLY type that holds an array's values: none of them is 64-bit and whole."""
    kind = values.dtype.str[1:]
    if kind in _NAMES:
        return kind
    return "u1" if values.dtype.kind == "b" else "f8"


def _header(count: int, kinds: list[tuple[str, str]], remarks: str) -> bytes:
    """The head of a file of ``count`` vertices; always of one length, so it can be written anew."""
    properties = "".join(f"property {_NAMES[kind]} {name}\n" for name, kind in kinds)
    vertices = f"element vertex {count:<12}\n{properties}"
    return f"ply\nformat binary_little_endian 1.0\n{remarks}{vertices}end_header\n".encode()
