"""From named columns to a Cloud and back: the one place that knows what files call things."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.checks import METRES_PER_UNIT
from skipnet.clouds.cloud import Cloud
from skipnet.types import FloatArray, IntArray

_AXES = tuple(
    (axis, f"field.{axis}", f"points:{number}", f"points_m_xyz:{number}", f"{axis}_coord",
     f"coord_{axis}", f"{axis}coord", f"{axis}-coordinate", f"{axis}_coordinate", f"coord{axis}",
     f"pos_{axis}", f"position_{axis}", f"pos{axis}", f"p{axis}", *others)
    for number, axis, others in (
        (0, "x", ("easting", "east", "rechtswert", "x coordinate")),
        (1, "y", ("northing", "north", "hochwert", "y coordinate")),
        (2, "z", ("elevation", "height", "altitude", "höhe", "hoehe", "z coordinate")),
    )
)  # fmt: skip
_COLOURS = (
    ("r", "red", "rf", "diffuse_red"),
    ("g", "green", "gf", "diffuse_green"),
    ("b", "blue", "bf", "diffuse_blue"),
)
_FINE = ("red_16", "green_16", "blue_16")
"""Colours of 16 bits beside those of 8 that all programs show."""
_NORMALS = tuple((f"n{axis}", f"normal_{axis}", f"normal{axis}") for axis in "xyz")
_INTENSITY = (("intensity", "i", "reflectance", "reflectivity", "scalar_intensity", "remission"),)
_UNIT_WORDS = {
    **{unit: unit for unit in METRES_PER_UNIT},
    **{"foot": "ft", "feet": "ft", "inch": "in", "inches": "in"},
    **{f"{prefix}met{end}": unit for prefix, unit in
       (("", "m"), ("milli", "mm"), ("centi", "cm"), ("kilo", "km"))
       for end in ("re", "res", "er", "ers")},
}  # fmt: skip
_ANY_UNIT = "|".join(sorted(_UNIT_WORDS, key=len, reverse=True))
_UNIT = re.compile(
    rf"^(.*?)[\s_]*[\[(<]\s*({_ANY_UNIT})\s*[\])>]$|^([xyz])_({_ANY_UNIT})$"
    rf"|^(.+?)(?: in |/)({_ANY_UNIT})$"
)
_SAID_UNIT = re.compile(
    rf"\bunits?\b[^a-z0-9]*(?:(?:is|are|of|length)\b[^a-z0-9]*)*({_ANY_UNIT})\b"
)


def plain_name(name: str) -> tuple[str, str | None]:
    """A column's name in small letters without its unit, and the unit if it names one.

    >>> plain_name("X [mm]"), plain_name("Red")
    (('x', 'mm'), ('red', None))
    """
    name = name.strip(" \"'/#").lower()
    match = _UNIT.match(name)
    if match is None:
        return name, None
    name, unit = next((match[k], match[k + 1]) for k in (1, 3, 5) if match[k + 1])
    return name, _UNIT_WORDS[unit]


def unit_word(word: str) -> str | None:
    """The unit that a word alone stands for, or None."""
    return _UNIT_WORDS.get(word.strip(" \"'[](){}<>").lower())


def unit_in(remark: str) -> str | None:
    """The unit that a sentence of a file's head says it is in, or None.

    >>> unit_in("comment units: millimeters"), unit_in("made by a unit test")
    ('mm', None)
    """
    match = _SAID_UNIT.search(remark.lower())
    return _UNIT_WORDS[match[1]] if match else None


def decoded(line: bytes) -> str:
    """A line of a head, in UTF-8 where it can be, else Latin-1."""
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")


def find_axes(names: list[str]) -> list[int]:
    """Which three of some columns are x, y, z by their names; empty if not all three are there."""
    plain = [plain_name(name)[0] for name in names]
    found = [next((plain.index(one) for one in axis if one in plain), -1) for axis in _AXES]
    return [] if -1 in found else found


def cloud_of_columns(
    table: Mapping[str, np.ndarray], path: Path, unit: str = "auto", **facts: Any
) -> Cloud:
    """A Cloud of (N,) columns under the names that they have in a file.

    Args:
        table: the columns; x, y, z (or easting, ...) among them, colours, normals and intensity
            recognised by their names, the others kept as they are.
        path: for the messages.
        unit: of the coordinates, where the columns' names hold none; "auto": metres.
        facts: what else the file knows: fields of Cloud.

    Raises:
        ValueError: there is no x, y or z.
    """
    names = list(table)
    axes = [names[index] for index in find_axes(names)]
    if not axes:
        raise ValueError(f"{path}: lacks x, y or z: it has {', '.join(names) or 'no columns'}")
    unit = plain_name(axes[0])[1] or ("m" if unit == "auto" else unit)
    left = {name: table[name] for name in names if name not in axes}
    return Cloud(
        points_m=stacked([table[axis] for axis in axes]) * METRES_PER_UNIT[unit],
        colour=_colour(left),
        normals=_taken(left, _NORMALS),
        intensity=take_intensity(left),
        columns=left,
        unit=unit,
        **{"name": str(path), **facts},
    )


def stacked(columns: list[np.ndarray]) -> FloatArray:
    """(N, k) float64 of k columns."""
    table = np.empty((len(columns[0]), len(columns)))
    for index, column in enumerate(columns):
        table[:, index] = column
    return table


def _pop(left: dict[str, np.ndarray], aliases: tuple[tuple[str, ...], ...]) -> list[np.ndarray]:
    """Take the columns of one thing out of those that are left; none of them if one is missing."""
    plain = {plain_name(name)[0]: name for name in reversed(left)}
    names = [next((plain[one] for one in group if one in plain), None) for group in aliases]
    if None in names:
        return []
    return [left.pop(name) for name in names if name is not None]


def _taken(left: dict[str, np.ndarray], aliases: tuple[tuple[str, ...], ...]) -> FloatArray | None:
    columns = _pop(left, aliases)
    return stacked(columns) if columns else None


def take_intensity(left: dict[str, np.ndarray]) -> FloatArray | None:
    """Take (N,) intensities out of columns, if one has such a name."""
    table = _taken(left, _INTENSITY)
    return None if table is None else table[:, 0]


def _colour(left: dict[str, np.ndarray]) -> IntArray | None:
    columns = _pop(left, _COLOURS)
    if columns:
        return as_colour(_pop(left, tuple((name,) for name in _FINE)) or columns)
    packed = left.get("rgb")
    if packed is None or packed.ndim > 1 or packed.dtype.kind == "b" or not _is_packed(packed):
        return None
    bits = left.pop("rgb").astype(np.int64)
    return np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=1).astype(np.uint8)


def _is_packed(values: np.ndarray) -> bool:
    """Whether numbers hold red, green and blue in their bytes."""
    whole = np.isfinite(values).all() and (values == np.rint(values)).all()
    return bool(whole and values.min(initial=0) >= 0 and 255 < values.max(initial=0) < 2**32)


def as_colour(columns: list[np.ndarray]) -> IntArray:
    """(N, 3) uint8 or uint16 of red, green and blue in 0..1, 0..255 or 0..65535, told apart by
    their values; columns of 16 bits stay as they are (see ``settled_colour``).

    >>> as_colour([np.array([0.0, 1.0]), np.array([0.5, 0.5]), np.array([0.0, 0.0])]).tolist()
    [[0, 128, 0], [255, 128, 0]]
    """
    if all(column.dtype.str[1:] == "u2" for column in columns):
        return np.stack(columns, axis=1).astype(np.uint16, copy=False)
    table = np.nan_to_num(stacked(columns), posinf=0, neginf=0)
    brightest = table.max(initial=0)
    if brightest <= 1 and (columns[0].dtype.kind == "f"):
        table *= 255
    deepest = 65535 if brightest > 255 else 255
    return np.clip(np.rint(table), 0, deepest).astype(np.uint16 if deepest > 255 else np.uint8)


def settled_colour(colour: IntArray | None) -> IntArray | None:
    """The colours of a whole file, as 8 bits where its 16 hold no more: all of them times 257, or
    256, or as they are.

    >>> settled_colour(np.array([[257, 0, 65535]], np.uint16)).tolist()
    [[1, 0, 255]]
    """
    if colour is None or colour.dtype != np.uint16:
        return colour
    if colour.max(initial=0) <= 255:
        return colour.astype(np.uint8)
    for step in (257, 256):
        if not (colour[:1000] % step).any() and not (colour % step).any():
            return (colour >> 8).astype(np.uint8)
    return colour


def columns_of_cloud(cloud: Cloud) -> dict[str, np.ndarray]:
    """Named columns as files have them: x, y, z in the cloud's unit, then what else there is."""
    points = cloud.points_m / METRES_PER_UNIT[cloud.unit]
    table: dict[str, np.ndarray] = dict(zip("xyz", points.T, strict=True))
    if cloud.normals is not None:
        table |= dict(zip(("nx", "ny", "nz"), cloud.normals.T, strict=True))
    if cloud.colour is not None:
        table |= dict(zip(("red", "green", "blue"), cloud.colour.T, strict=True))
    if cloud.intensity is not None:
        table["intensity"] = cloud.intensity
    return table | {name: values for name, values in cloud.columns.items() if name not in table}


def has_fine_colours(cloud: Cloud) -> bool:
    """Whether eight bits are too few for the colours, or may be for those of later pieces."""
    colour = cloud.colour
    if colour is None or colour.dtype != np.uint16:
        return False
    return not colour.any() or settled_colour(colour).dtype == np.uint16  # type: ignore[union-attr]


def columns_in_8_bits(cloud: Cloud, with_fine: bool) -> dict[str, np.ndarray]:
    """As ``columns_of_cloud``, colours in eight bits, for formats in which few programs read more;
    on request those of 16 bits stand beside them."""
    table = columns_of_cloud(replace(cloud, colour=cloud.colour_8bit))
    if with_fine and cloud.colour is not None:
        table |= dict(zip(_FINE, cloud.colour.T, strict=True))
    return table
