"""KITTI's .bin: nothing but float32 x, y, z, reflectance."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud

RECORDS_AT_ONCE = 1 << 18
"""Records read in one go."""
_RECORD_BYTES = 16
_FARTHEST_M = 1000.0
"""Of what a rotating scanner reaches: other contents seldom are numbers below it."""


def read_kitti(path: Path) -> Iterator[Cloud]:
    """The points of a rotating scanner with their reflectance.

    Raises:
        ValueError: the numbers cannot be such points.
    """
    if path.stat().st_size % _RECORD_BYTES:
        raise ValueError(
            f"{path}: truncated or not KITTI's layout: its {path.stat().st_size} bytes are no "
            "whole number of records of four float32"
        )
    with open(path, "rb") as file:
        while body := file.read(RECORDS_AT_ONCE * _RECORD_BYTES):
            table = np.frombuffer(body, "<f4").reshape(-1, 4)
            usable = (np.abs(table[:, :3]) < _FARTHEST_M).all() and np.isfinite(table).all()
            if not usable:
                raise ValueError(
                    f"{path}: not KITTI's layout of four float32 (x, y, z, reflectance): as such "
                    f"it holds coordinates beyond {_FARTHEST_M:g} m or none at all"
                )
            yield Cloud(table[:, :3].astype(np.float64), intensity=table[:, 3], name=str(path))
