"""LAS and LAZ files, through laspy, a piece at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skipnet.checks import missing_package
from skipnet.clouds.formats.ply import RECORDS_AT_ONCE
from skipnet.types import FloatArray


def read_las(path: Path) -> Iterator[FloatArray]:
    try:
        import laspy
    except ModuleNotFoundError as error:
        raise missing_package(path, "laspy") from error
    present = 0
    try:
        with laspy.open(path) as file:
            announced = file.header.point_count
            for cloud in file.chunk_iterator(RECORDS_AT_ONCE):
                present += len(cloud)
                # Scaled by hand: the chunk's own x, y, z would make three more copies.
                raw = np.stack([cloud.X, cloud.Y, cloud.Z], axis=1)
                yield raw * file.header.scales + file.header.offsets
    except Exception as error:  # laspy and its decompressors raise many kinds for a damaged file
        raise ValueError(f"{path}: truncated or not a LAS/LAZ file: {error}") from error
    if present != announced:
        raise ValueError(
            f"{path}: truncated: its header announces {announced} points, it holds {present}"
        )
