"""From named columns to a Cloud and back: the one place that knows what files call things."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.checks import METRES_PER_UNIT
from skipnet.clouds.cloud import Cloud
from skipnet.types import FloatArray, IntArray

_AXES = (
    ("x", "easting", "east", "x_coord", "coord_x", "xcoord", "pos_x", "position_x", "px"),
    ("y", "northing", "north", "y_coord", "coord_y", "ycoord", "pos_y", "position_y", "py"),
    ("z", "elevation", "height", "altitude", "z_coord", "coord_z", "zcoord", "pos_z", "position_z",
     "pz"),
)  # fmt: skip
_COLOURS = (
    ("r", "red", "rf", "diffuse_red"),
    ("g", "green", "gf", "diffuse_green"),
    ("b", "blue", "bf", "diffuse_blue"),
)
_NORMALS = (("nx", "normal_x"), ("ny", "normal_y"), ("nz", "normal_z"))
_INTENSITY = (("intensity", "i", "reflectance", "reflectivity", "scalar_intensity", "remission"),)
_UNIT = re.compile(
    r"^(.*?)[\s_]*[\[(<]\s*(mm|cm|km|m|ft|in)\s*[\])>]$|^([xyz])_(mm|cm|km|m|ft|in)$"
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
    return match[1] or match[3], match[2] or match[4]


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
        unit: of the coordinates; "auto" takes the one that the columns' names hold, else metres.
        facts: what else the file knows: fields of Cloud.

    Raises:
        ValueError: there is no x, y or z.
    """
    names = list(table)
    axes = [names[index] for index in find_axes(names)]
    if not axes:
        raise ValueError(f"{path}: lacks x, y or z: it has {', '.join(names) or 'no columns'}")
    if unit == "auto":
        unit = plain_name(axes[0])[1] or "m"
    left = {name: table[name] for name in names if name not in axes}
    return Cloud(
        points_m=stacked([table[axis] for axis in axes]) * METRES_PER_UNIT[unit],
        colour=_colour(left),
        normals=_taken(left, _NORMALS),
        intensity=_single(_taken(left, _INTENSITY)),
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


def _single(table: FloatArray | None) -> FloatArray | None:
    return None if table is None else table[:, 0]


def _colour(left: dict[str, np.ndarray]) -> IntArray | None:
    columns = _pop(left, _COLOURS)
    return as_colour(columns) if columns else None


def as_colour(columns: list[np.ndarray]) -> IntArray:
    """(N, 3) uint8 of red, green and blue in 0..1, 0..255 or 0..65535, told apart by their values.

    >>> as_colour([np.array([0.0, 1.0]), np.array([0.5, 0.5]), np.array([0.0, 0.0])]).tolist()
    [[0, 128, 0], [255, 128, 0]]
    """
    table = np.nan_to_num(stacked(columns), posinf=0, neginf=0)
    brightest = table.max(initial=0)
    if brightest <= 1 and (columns[0].dtype.kind == "f"):
        table *= 255
    elif brightest > 255:
        table /= 257
    return np.clip(np.rint(table), 0, 255).astype(np.uint8)


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
