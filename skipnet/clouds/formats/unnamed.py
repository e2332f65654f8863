"""Which column is which in a table without names: said, and refused where no guess makes sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skipnet.types import FloatArray

_RGB = ["red", "green", "blue"]
_NORMAL = ["nx", "ny", "nz"]
_ENOUGH_ROWS = 10
"""Of fewer rows nothing can be said."""


def name_columns(table: FloatArray, path: Path) -> tuple[list[str], tuple[str, ...]]:
    """Names for the columns of a table, by their number and their values.

    The first three are x, y, z. Colours are three whole numbers up to 255, normals three numbers of
    length one, a fourth or seventh number is the intensity; the others are called by their place.

    Args:
        table: (N, k) numbers, k >= 3.
        path: for the messages.

    Returns:
        The k names, and what was decided, for a person, where there is more than x, y and z.

    Raises:
        ValueError: the first three cannot be x, y and z.
    """
    _check_places(table, path)
    width = table.shape[1]
    names = [f"column {number}" for number in range(1, width + 1)]
    names[:3] = "xyz"
    if width in (4, 7) and not _are_colours(table[:, 3:6]):
        names[3] = "intensity"
    for start in range(3, width - 2):
        three = table[:, start : start + 3]
        if any(name in names for name in _RGB) and any(name in names for name in _NORMAL):
            break
        if not names[start].startswith("column"):
            continue
        if "red" not in names and _are_colours(three):
            names[start : start + 3] = _RGB
        elif "nx" not in names and _are_normals(three):
            names[start : start + 3] = _NORMAL
    if width == 7 and names[3:6] == _RGB:
        names[6] = "intensity"
    notes = (f"columns taken as {', '.join(names)}",) if width > 3 else ()
    return names, notes


def _are_colours(three: FloatArray) -> bool:
    whole = (three == np.rint(three)).all() and (three >= 0).all() and (three <= 255).all()
    return bool(three.shape[1] == 3 and len(three) and whole and np.ptp(three) > 1)


def _are_normals(three: FloatArray) -> bool:
    lengths = np.linalg.norm(three, axis=1)
    return bool(len(three) and (np.abs(lengths - 1) < 0.02).mean() > 0.9)


def _check_places(table: FloatArray, path: Path) -> None:
    """Refuse a first column that counts the lines, and whole numbers beside fractions."""
    if len(table) < _ENOUGH_ROWS:
        return
    places = table[:, :3]
    whole = [bool((column == np.rint(column)).all()) for column in places.T]
    moving = [bool(np.ptp(column) > 0) for column in places.T]
    fractions = not all(whole)
    odd = [axis + 1 for axis in range(3) if whole[axis] and moving[axis] and fractions]
    counts_lines = table.shape[1] > 3 and (np.diff(places[:, 0]) == 1).all()
    if odd or counts_lines:
        what = (
            "counts the lines" if counts_lines else "holds whole numbers alone, unlike the others"
        )
        raise ValueError(
            f"{path}: column {1 if counts_lines else odd[0]} {what}: it is hardly a coordinate; "
            "name the columns in a first line, such as: row x y z"
        )
