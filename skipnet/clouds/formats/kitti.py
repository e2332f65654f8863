"""Raw numbers: KITTI's .bin, float32 x, y, z, reflectance, and what is like it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_FARTHEST_M = 1000.0
"""Of what a rotating scanner reaches: other contents seldom are numbers below it."""
_BRIGHTEST = 65535
_LOOKED_AT = 1 << 14


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
        beside = table[np.isfinite(table[:, :3]).all(axis=1), 3:]
        usable = ((beside >= 0) & (beside <= _BRIGHTEST)).all()
        if "ring" in self.names:
            usable &= (beside[:, 1] == np.rint(beside[:, 1])).all()
        return bool(_are_near(table[:, :3]) and usable)


_KITTI = _Records("<f4", ("x", "y", "z", "reflectance"))
_OTHERS = (
    _Records("<f4", ("x", "y", "z", "reflectance", "ring")),
    _Records("<f4", ("x", "y", "z")),
    _Records("<f8", ("x", "y", "z", "reflectance")),
    _Records("<f8", ("x", "y", "z")),
)


def _are_near(places_m: np.ndarray) -> bool:
    """Coordinates within a scanner's reach; rows of NaN stand for beams that met nothing."""
    met = places_m[np.isfinite(places_m).all(axis=1)]
    return bool(2 * len(met) > len(places_m) and (np.abs(met) < _FARTHEST_M).all())


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
    return Cloud(
        table[:, :3].astype(np.float64),
        intensity=table[:, 3] if "reflectance" in records.names else None,
        columns={"ring": table[:, 4]} if "ring" in records.names else {},
        name=str(path),
        notes=() if records is _KITTI else (note,),
    )


def _find_records(start: bytes, size: int, path: Path) -> _Records:
    """KITTI's records if the numbers can be such, else the first others that they can be."""
    whole = [one for one in (_KITTI, *_OTHERS) if size % one.size == 0]
    if not whole:
        raise ValueError(
            f"{path}: truncated or not KITTI's layout: its {size} bytes are no whole number of "
            "records of four float32"
        )
    # 240 is a multiple of every record's length: no record is cut.
    for one in whole:
        if one.fits(start):
            return one
    if _KITTI not in whole or not _are_near(_KITTI.read(start)[:, :3]):
        raise _refusal(path)
    return _KITTI


def _refusal(path: Path) -> ValueError:
    return ValueError(
        f"{path}: not KITTI's layout of four float32 (x, y, z, reflectance): as such "
        f"it holds coordinates beyond {_FARTHEST_M:g} m or none at all"
    )
