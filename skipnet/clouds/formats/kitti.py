"""Raw numbers: KITTI's .bin, float32 x, y, z, reflectance, and what is like it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import cloud_of_columns

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_FARTHEST_M = 1000.0
"""Of what a rotating scanner reaches: other contents seldom are numbers below it."""
_LEAST = 1e-30
"""Whole numbers, read as floats, lie below it; what was measured is zero or above."""
_NEAREST_M = 1e-3
"""A scan is larger."""
_BRIGHTEST = 65535
_LOOKED_AT = 1 << 14
_CLEARLY = 0.1
"""So much smaller (nats) must the spread of the columns be for another layout than KITTI's ..."""
_FEW = 200
"""... and more by chance where there are hardly more records than so many."""


@dataclass(frozen=True)
class _Records:
    kind: str
    names: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return len(self.names) * np.dtype(self.kind).itemsize

    def read(self, body: bytes) -> np.ndarray:
        """(N, k) numbers of whole records."""
        whole = len(body) // self.size * self.size
        return np.frombuffer(body[:whole], self.kind).reshape(-1, len(self.names))

    def fits(self, body: bytes) -> bool:
        """Whether the numbers can be such records."""
        table = self.read(body)
        met = table[np.isfinite(table[:, :3]).all(axis=1)]
        usable = bool((met[:, 3:4] >= 0).all() and (met[:, 3:4] <= _BRIGHTEST).all())
        if "ring" in self.names:
            usable &= bool(((met[:, 4] >= 0) & (met[:, 4] == np.rint(met[:, 4]))).all())
        if "red" in self.names:
            usable &= _are_colours(met[:, 3:6])
        return usable and _are_near(table[:, :3])

    def spread(self, body: bytes) -> float:
        """How widely the numbers of a column scatter: the mean of its logarithm.

        Under a wrong number of columns each of them is a mixture of several, and scatters more.
        """
        table = self.read(body).astype(np.float64)
        widths = table[np.isfinite(table).all(axis=1)].std(axis=0)
        return float(np.log(np.maximum(widths, _NEAREST_M)).mean()) if len(widths) else np.inf


_KITTI = _Records("<f4", ("x", "y", "z", "reflectance"))
_OTHERS = (
    _Records("<f4", ("x", "y", "z", "reflectance", "ring")),
    _Records("<f4", ("x", "y", "z")),
    _Records("<f8", ("x", "y", "z", "reflectance")),
    _Records("<f8", ("x", "y", "z")),
    _Records("<f4", ("x", "y", "z", "red", "green", "blue")),
    _Records("<f4", ("x", "y", "z", "reflectance", "column 5")),
    _Records("<f4", ("x", "y", "z", "reflectance", "column 5", "column 6")),
)


def _are_near(places_m: np.ndarray) -> bool:
    """Coordinates within a scanner's reach; rows of NaN stand for beams that met nothing."""
    met = np.abs(places_m[np.isfinite(places_m).all(axis=1)])
    is_measured = not len(met) or bool((met >= _LEAST).any() and not _are_tiny(met).any())
    return bool(2 * len(met) > len(places_m) and (met < _FARTHEST_M).all()) and is_measured


def _are_tiny(sizes: np.ndarray) -> np.ndarray:
    return (sizes > 0) & (sizes < _LEAST)


def _are_colours(table: np.ndarray) -> bool:
    """Shares of one, or whole numbers of a byte."""
    if not ((table >= 0) & (table <= 255)).all():
        return False
    return bool((table <= 1).all() or (table == np.rint(table)).all())


def read_kitti(path: Path) -> Iterator[Cloud]:
    """The points of a rotating scanner with their reflectance, and perhaps the number of the ring.

    Raises:
        ValueError: the numbers cannot be such points.
    """
    size = path.stat().st_size
    with open(path, "rb") as file:
        records = _find_records(file.read(_LOOKED_AT * 240), size, path)
        file.seek(0)
        while body := file.read(RECORDS_AT_ONCE * records.size):
            table = records.read(body)
            if not _are_near(table[:, :3]):
                raise _refusal(path)
            yield _cloud(table, records, path)


def _cloud(table: np.ndarray, records: _Records, path: Path) -> Cloud:
    note = f"columns taken as {', '.join(records.names)} ({np.dtype(records.kind).name})"
    columns = dict(zip(records.names, table.T, strict=True))
    columns |= {axis: columns[axis].astype(np.float64) for axis in "xyz"}
    return cloud_of_columns(columns, path, notes=() if records is _KITTI else (note,))


def _find_records(start: bytes, size: int, path: Path) -> _Records:
    """The first of the layouts that the numbers can be whose columns scatter least."""
    whole = [one for one in (_KITTI, *_OTHERS) if size % one.size == 0]
    if not whole:
        raise ValueError(
            f"{path}: truncated or not KITTI's layout: its {size} bytes are no whole number of "
            "records of four float32"
        )
    # 240 is a multiple of every record's length: no record is cut.
    fitting = [one for one in whole if one.fits(start)]
    # Pairs of float32 look like doubles, random halves of doubles hardly like float32.
    fitting = [one for one in fitting if one.kind == "<f4"] or fitting
    if fitting:
        spreads = [one.spread(start) for one in fitting]
        margin = _CLEARLY * (1 + _FEW * _KITTI.size / len(start))
        return next(
            one
            for one, spread in zip(fitting, spreads, strict=True)
            if spread <= min(spreads) + margin
        )
    if _KITTI not in whole or not _are_near(_KITTI.read(start)[:, :3]):
        raise _refusal(path)
    return _KITTI


def _refusal(path: Path) -> ValueError:
    return ValueError(
        f"{path}: not KITTI's layout of four float32 (x, y, z, reflectance): as such "
        f"it holds coordinates beyond {_FARTHEST_M:g} m or none at all"
    )
