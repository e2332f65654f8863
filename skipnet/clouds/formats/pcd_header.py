"""The head of a PCD file, every word of it checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from skipnet.clouds.formats.columns import decoded
from skipnet.types import FloatArray

_LONGEST_HEADER_LINES = 100
_ENCODINGS = ("ascii", "binary", "binary_compressed")


@dataclass(frozen=True)
class PcdHeader:
    """What the body holds, and how."""

    names: list[str]
    kinds: list[str]
    """NumPy kind of each field."""
    counts: list[int]
    """Numbers in each field."""
    points: int
    encoding: str
    viewpoint_m: FloatArray | None

    @property
    def dtype(self) -> np.dtype:
        """A record as it stands in a binary body; fields called _ are padding."""
        return np.dtype(
            [
                (f"{name} {index}", f"<{kind}", (count,))
                for index, (name, kind, count) in enumerate(
                    zip(self.names, self.kinds, self.counts, strict=True)
                )
            ]
        )


def read_header(file: BinaryIO, path: Path) -> PcdHeader:
    """Read the head of an open file up to its line DATA.

    Raises:
        ValueError: it is no PCD file, or a word of its head cannot be right.
    """
    lines: dict[str, list[str]] = {}
    for _ in range(_LONGEST_HEADER_LINES):
        words = decoded(file.readline(4096)).split()
        if words and not words[0].startswith("#"):
            lines[words[0].upper()] = words[1:]
        if "DATA" in lines:
            break
    names = lines.get("FIELDS", lines.get("COLUMNS", []))
    if "DATA" not in lines or not names:
        raise ValueError(f"{path}: truncated or not a PCD file: its header lacks FIELDS or DATA")
    if not {"x", "y", "z"} <= {name.lower() for name in names}:
        raise ValueError(f"{path}: its FIELDS lack x, y or z: they are {' '.join(names)[:80]}")
    encoding = " ".join(lines["DATA"]).lower()
    if encoding not in _ENCODINGS:
        raise ValueError(
            f"{path}: unknown DATA {encoding[:40]!r}: expected one of {', '.join(_ENCODINGS)}"
        )
    counts = _whole_numbers(lines, "COUNT", [1] * len(names), path)
    return PcdHeader(
        names, _kinds(lines, names, path), counts, _announced(lines, path), encoding,
        _viewpoint(lines.get("VIEWPOINT", [])),
    )  # fmt: skip


def _whole_numbers(
    lines: dict[str, list[str]], keyword: str, default: list[int], path: Path
) -> list[int]:
    words = lines.get(keyword, [str(number) for number in default])
    if len(words) != len(default) or not all(word.isdecimal() and len(word) < 7 for word in words):
        raise ValueError(
            f"{path}: damaged header: expected {len(default)} whole numbers after {keyword}"
        )
    numbers = [int(word) for word in words]
    if 0 in numbers and keyword != "COUNT":
        raise ValueError(f"{path}: damaged header: a 0 after {keyword}")
    return numbers


def _kinds(lines: dict[str, list[str]], names: list[str], path: Path) -> list[str]:
    sizes = _whole_numbers(lines, "SIZE", [4] * len(names), path)
    types = [word.lower() for word in lines.get("TYPE", ["F"] * len(names))]
    kinds = [f"{kind}{size}" for kind, size in zip(types, sizes, strict=False)]
    known = [f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)] + ["f4", "f8"]
    if len(types) != len(names) or not set(kinds) <= set(known):
        raise ValueError(
            f"{path}: damaged header: TYPE and SIZE are {' '.join(kinds)[:80]}: expected one of "
            f"{', '.join(known)} for each field"
        )
    return kinds


def _announced(lines: dict[str, list[str]], path: Path) -> int:
    """How many points the header promises."""
    products = []
    for keywords in (("POINTS",), ("WIDTH", "HEIGHT")):
        words = [word for keyword in keywords for word in lines.get(keyword, [])]
        if len(words) == len(keywords) and all(word.isdecimal() for word in words):
            products.append(int(words[0]) * int(words[-1] if len(words) > 1 else 1))
    if not products or len(set(products)) > 1:
        raise ValueError(
            f"{path}: truncated or not a PCD file: expected POINTS, equal to WIDTH x HEIGHT"
        )
    return products[0]


def _viewpoint(words: list[str]) -> FloatArray | None:
    """(3,) the sensor's place; None for zeros, which writers put who know of none."""
    try:
        place_m = np.array([float(word) for word in words[:3]])
    except ValueError:
        return None
    known = place_m.shape == (3,) and np.isfinite(place_m).all() and place_m.any()
    return place_m if known else None
