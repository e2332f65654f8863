"""Described scans on disk: one file each, whole or not at all, found by what they were made of."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skipnet.networks.model import Model
from skipnet.scans.describing import describe, restored
from skipnet.scans.record import FORMAT, read_record, write_record
from skipnet.scans.scan import AutoAt, Scan, Viewpoint
from skipnet.skipmap.tree import Points, SkipTree
from skipnet.types import FloatArray


class ScanStore:
    """A folder of described scans."""

    def __init__(self, folder: Path) -> None:
        """Nothing is written, nor the folder made, before there is a scan to keep."""
        self.folder = Path(folder)

    def describe(
        self,
        clouds_m: Sequence[Points],
        viewpoints: Sequence[Viewpoint],
        voxel_size_m: float,
        seed: int,
        network: Model,
    ) -> list[Scan]:
        """As ``skipnet.scans.describing.describe``, with what is in the folder taken from there.

        Args:
            clouds_m: as there.
            viewpoints: as there.
            voxel_size_m: as there; it is part of what is kept, so it must be fixed.
            seed: as there.
            network: as there.
        """
        keys = [
            scan_key(cloud_m, viewpoint, voxel_size_m, seed, network)
            for cloud_m, viewpoint in zip(clouds_m, viewpoints, strict=True)
        ]
        kept = {key: scan for key in keys if (scan := self.load(key, network)) is not None}
        missing = [i for i, key in enumerate(keys) if key not in kept]
        if missing:
            some = [clouds_m[i] for i in missing], [viewpoints[i] for i in missing]
            fresh = describe(*some, voxel_size_m, seed, network)
            for i, scan in zip(missing, fresh, strict=True):
                write_record(scan.record, self._file(keys[i]))
                kept[keys[i]] = scan
        return [kept[key] for key in keys]

    def load(self, key: str, network: Model) -> Scan | None:
        """The scan under a key, to the same bits; None where there is none that can be read."""
        try:
            return restored(read_record(self._file(key)), network)
        except (FileNotFoundError, ValueError):
            return None

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def scan_key(
    cloud_m: Points, viewpoint: Viewpoint, voxel_size_m: float, seed: int, network: Model
) -> str:
    """Digest of all that a description depends on: 32 hexadecimal digits."""
    sha = hashlib.sha256()
    for array in _arrays(cloud_m):
        sha.update(f"{array.dtype} {array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)
    if not (isinstance(viewpoint, str | AutoAt) or viewpoint is None):
        viewpoint = np.asarray(viewpoint, dtype=np.float64).tolist()
    options = FORMAT, viewpoint, float(voxel_size_m).hex(), seed, network.digest
    sha.update(repr(options).encode())
    return sha.hexdigest()[:32]


def _arrays(cloud_m: Points) -> list[FloatArray]:
    if not isinstance(cloud_m, SkipTree):
        return [cloud_m]
    size_m = np.array([cloud_m.voxel_size_m])
    return [size_m, cloud_m.origin_m, cloud_m.keys, cloud_m.moments.sums]
