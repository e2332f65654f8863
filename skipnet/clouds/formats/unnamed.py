"""Which column is which in a table without names: said, and refused where no guess makes sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skipnet.types import FloatArray

_RGB = ["red", "green", "blue"]
_NORMAL = ["nx", "ny", "nz"]
_ENOUGH_ROWS = 10
"""Of fewer rows nothing can be said."""
_WIDER = 2.5
"""No two shares of one, of either sign, lie farther apart."""
_FAR = 1000.0
"""Whole numbers beyond are rather a grid of map coordinates than rows and columns."""


_MOST_COLUMNS = 1000
"""Per point; of more, something else is stored."""


def name_columns(
    table: FloatArray, path: Path, is_pts: bool = False
) -> tuple[list[str], tuple[str, ...]]:
    """Names for the columns of a table, by their number and their values.

    The first three are x, y, z. Colours are three whole numbers up to 255 or three shares,
    normals three numbers of length one, a fourth or seventh number is the intensity; the others
    are called by their place.

    Args:
        table: (N, k) numbers, k >= 3.
        path: for the messages.
        is_pts: of seven columns the fourth is the intensity, whatever its values.

    Returns:
        The k names, and what was decided, for a person, where there is more than x, y and z.

    Raises:
        ValueError: the first three cannot be x, y and z.
    """
    _check_places(table, path)
    width = table.shape[1]
    if width > _MOST_COLUMNS:
        raise ValueError(f"{path}: has {width:,} columns: expected x, y, z and a few more")
    names = [f"column {number}" for number in range(1, width + 1)]
    names[:3] = "xyz"
    pts = is_pts and width == 7 and _may_be_colours(table[:, 4:7])
    if pts:
        names[3:] = ["intensity", *_RGB]
    elif width in (4, 7) and not _are_colours(table[:, 3:6]):
        names[3] = "intensity"
    for start in range(3, width - 2):
        _name_three(names, table[:, start : start + 3], start)
    if width == 7 and names[3:6] == _RGB:
        names[6] = "intensity"
    notes = (f"columns taken as {', '.join(names)}",) if width > 3 else ()
    return names, notes


def _name_three(names: list[str], three: FloatArray, start: int) -> None:
    """Name three columns if they are colours or normals and nothing yet."""
    if not all(name.startswith("column") for name in names[start : start + 3]):
        return
    if "nx" not in names and _are_normals(three):
        names[start : start + 3] = _NORMAL
    elif "red" not in names and (_are_colours(three) or _are_shares(three)):
        names[start : start + 3] = _RGB


def _may_be_colours(three: FloatArray) -> bool:
    whole = (three == np.rint(three)).all() and (three >= 0).all() and (three <= 255).all()
    return bool(three.shape[1] == 3 and len(three) and whole)


def _are_colours(three: FloatArray) -> bool:
    return _may_be_colours(three) and bool(np.ptp(three) > 1)


def _are_shares(three: FloatArray) -> bool:
    """Colours as numbers from 0 to 1."""
    inside = bool((three >= 0).all() and (three <= 1).all())
    return len(three) >= _ENOUGH_ROWS and inside and bool((np.ptp(three, axis=0) > 0).all())


def _are_normals(three: FloatArray) -> bool:
    lengths = np.linalg.norm(three, axis=1)
    return bool(len(three) and (np.abs(lengths - 1) < 0.02).mean() > 0.9)


def _is_intensity_before_places(table: FloatArray) -> bool:
    """Whether the first column is a share of one, and the fourth a coordinate: with fractions, on
    both sides of zero, and far beyond a share."""
    first, fourth = table[:, 0], table[:, 3]
    fractions = bool((fourth != np.rint(fourth)).any() and fourth.min() < 0 < fourth.max())
    inside = bool((first >= 0).all() and (first <= 1).all() and np.ptp(first) > 0)
    return inside and fractions and bool(np.ptp(fourth) > _WIDER * np.ptp(first))


def _check_places(table: FloatArray, path: Path) -> None:
    """Refuse a column that counts the lines or the time, and whole numbers beside fractions.

    Of three columns all must be coordinates: whole ones are a grid.
    """
    if len(table) < _ENOUGH_ROWS or table.shape[1] == 3:
        return
    places = table[:, :3]
    whole = [bool((column == np.rint(column)).all()) for column in places.T]
    moving = [bool(np.ptp(column) > 0) for column in places.T]
    near = [bool(np.abs(column).min() < _FAR) for column in places.T]
    odd = [
        axis + 1 for axis in range(3) if whole[axis] and moving[axis] and near[axis]
    ] if not all(whole) else []  # fmt: skip
    steps = np.diff(places[:, 0])
    counting = [
        axis + 1
        for axis in range(3)
        if (whole[axis] or axis == 0) and (np.diff(places[:, axis]) == 1).all()
    ]
    counts = bool(counting)
    tells_time = bool((steps > 0).all() and np.ptp(steps) < 0.01 * steps.mean())
    shines = not odd and _is_intensity_before_places(table)
    if not (odd or counts or tells_time or shines):
        return
    what = "counts the lines" if counts else "grows evenly from line to line, as a time does"
    if not (counts or tells_time):
        what = "holds whole numbers alone, unlike the others"
    if shines and not (counts or tells_time):
        what = "lies between 0 and 1, as an intensity does, and column 4 does not"
    column = (counting or ([1] if tells_time or shines else odd))[0]
    named = "row column x y z" if odd == [1, 2] else "row x y z"
    raise ValueError(
        f"{path}: column {column} {what}: it is hardly a "
        f"coordinate; name the columns in a first line, such as: {named}"
    )
