"""The head of a PLY file: elements and their columns, and what remarks say."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import decoded, unit_in
from skipnet.types import FloatArray

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8", "bool"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("int64", "longlong"), "i8"),
    **dict.fromkeys(("uint64", "ulonglong"), "u8"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER_LINES = 1000
_LONGEST_LINE = 1 << 16
_VERTICES = ("vertex", "vertices", "point", "points")
_PLACE, _CRS = "skipnet viewpoint_m", "skipnet crs"
"""Remarks with which our own files say what the format has no word for."""


@dataclass
class Element:
    """One element of the header, such as ``vertex``: how many records, and of which columns."""

    name: str
    count: int
    columns: list[tuple[str, str]] = field(default_factory=list)
    """Name and NumPy kind of each column; of a list, the kind of its entries."""
    lists: dict[str, str] = field(default_factory=dict)
    """Of the columns that are lists: the kind of the number of entries."""


@dataclass
class Header:
    """What stands above the records."""

    order: str = ""
    """The byte order; "" for ascii."""
    elements: list[Element] = field(default_factory=list)
    """In their order."""
    unit: str = "auto"
    """The one that a remark names."""
    viewpoint_m: FloatArray | None = None
    crs: str = ""

    def completes(self, cloud: Cloud) -> Cloud:
        """The cloud, with what the header says of it."""
        return replace(cloud, viewpoint_m=self.viewpoint_m, crs=self.crs)


def read_header(file: BinaryIO, path: Path) -> Header:
    """Read the head of a PLY file up to its end.

    Raises:
        ValueError: it is none, or has lines or formats that nobody knows.
    """
    if file.readline(16).strip().lower() != b"ply":
        raise ValueError(f"{path}: not a PLY file: its first line is not 'ply'")
    format_name, header = "", Header()
    for _ in range(_LONGEST_HEADER_LINES):
        words = decoded(file.readline(_LONGEST_LINE)).split()
        keyword = words[0].lower() if words else ""
        if keyword == "end_header":
            break
        if keyword == "format" and len(words) == 3:
            format_name = words[1].lower()
        elif keyword == "element" and len(words) == 3 and words[2].isdecimal():
            name = "vertex" if words[1].lower() in _VERTICES else words[1].lower()
            header.elements.append(Element(name, int(words[2])))
        elif keyword == "property" and header.elements:
            _add_property(header.elements[-1], words, path)
        elif keyword in ("comment", "obj_info"):
            _heed(" ".join(words[1:]), header)
        elif keyword:
            raise _unreadable(words, path)
    else:
        raise ValueError(f"{path}: truncated or not a PLY file: its header never ends")
    if format_name not in _BYTE_ORDERS:
        raise ValueError(
            f"{path}: unknown PLY format {format_name[:40]!r}: expected one of {list(_BYTE_ORDERS)}"
        )
    header.order = "" if format_name == "ascii" else _BYTE_ORDERS[format_name]
    return header


def _heed(remark: str, header: Header) -> None:
    """Take from a remark what it says of the points; what makes no sense is a remark."""
    if remark.startswith(_CRS):
        header.crs = remark[len(_CRS) :].strip()
    elif remark.startswith(_PLACE):
        try:
            place_m = np.array([float(word) for word in remark[len(_PLACE) :].split()])
        except ValueError:
            return
        if place_m.shape == (3,) and np.isfinite(place_m).all():
            header.viewpoint_m = place_m
    else:
        header.unit = unit_in(remark) or header.unit


def _unreadable(words: list[str], path: Path) -> ValueError:
    return ValueError(f"{path}: cannot read the header line {' '.join(words)[:80]!r}")


def _add_property(element: Element, words: list[str], path: Path) -> None:
    is_list = words[1:2] and words[1].lower() == "list"
    kinds = [_TYPES.get(word.lower()) for word in (words[2:4] if is_list else words[1:2])]
    known = {name for name, _ in element.columns}
    if len(words) != (5 if is_list else 3) or None in kinds:
        raise _unreadable(words, path)
    name = words[-1]
    while name in known:  # some writers repeat a name; both columns stand in the records
        name += "_"
    element.columns.append((name, str(kinds[-1])))
    if is_list:
        element.lists[name] = str(kinds[0])


def remarks_on(cloud: Cloud) -> str:
    """The lines for what the format has no word for."""
    said = []
    if cloud.viewpoint_m is not None:
        said.append(f"{_PLACE} {' '.join(repr(float(value)) for value in cloud.viewpoint_m)}")
    if cloud.unit != "m":
        said.append(f"units: {cloud.unit}")
    if cloud.crs:
        said.append(f"{_CRS} {' '.join(cloud.crs.split())}")
    return "".join(f"comment {line}\n" for line in said)
