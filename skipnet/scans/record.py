"""What is kept of a described scan: plain arrays, one file of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skipnet.clouds.formats.arrays import read_archive
from skipnet.scans.range_image import RangeImage
from skipnet.skipmap.moments import Moments
from skipnet.skipmap.tree import SkipTree
from skipnet.storage import replacing
from skipnet.types import FloatArray

FORMAT = 2
"""Of the files; another number when the same points would be described otherwise."""
_UNSEEN = RangeImage(np.full(3, np.nan), np.zeros((0, 0), dtype=np.float32))
"""Written where there is no image."""
_NUMBERS = ("sums", "T_given_own", "nearest_m", "side_nearest_m")


@dataclass(frozen=True)
class Record:
    """What has to be kept of a scan: plain arrays, from which all the rest follows, bit for bit."""

    T_given_own: FloatArray
    """(4, 4) from the scan's own frame, in which all the rest is, to the frame it was given in."""
    strays: int
    """Points left out of all the rest because they lie far from all others."""
    fine_tree: SkipTree
    """All voxels of half the size, effective or not."""
    range_image: RangeImage | None
    """How far the sensor saw; None when its place is unknown, or not to be trusted at all."""
    trust: float
    """What the evidence of the sensor's place is worth: 0 when it is unknown, to 1."""
    side: RangeImage | None
    """The thing as seen from a place afar, on the side from which it was scanned: so much is known
    where the sensor's own place is not. None where that is, or nothing tells."""
    seed: int
    """Of the order in which the judge samples voxels."""


def write_record(record: Record, path: Path) -> None:
    """Write what is kept of a scan, as named arrays without objects."""
    tree = record.fine_tree
    seen, side = record.range_image or _UNSEEN, record.side or _UNSEEN
    with replacing(path) as temporary:
        np.savez(
            temporary,
            format=FORMAT,
            T_given_own=record.T_given_own,
            strays=record.strays,
            voxel_size_m=tree.voxel_size_m,
            origin_m=tree.origin_m,
            keys=tree.keys,
            sums=tree.moments.sums,
            trust=record.trust,
            seed=record.seed,
            viewpoint_m=seen.viewpoint_m,
            nearest_m=seen.nearest_m,
            side_m=side.viewpoint_m,
            side_nearest_m=side.nearest_m,
        )


def read_record(path: Path) -> Record:
    """Read what ``write_record`` wrote.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file that is damaged, or of another format.
    """
    try:
        part = read_archive(path)
        if part["format"] != FORMAT:
            raise ValueError(f"format {part['format']}, expected {FORMAT}")
        _check(part)
        tree = SkipTree(
            float(part["voxel_size_m"]), part["origin_m"], part["keys"], Moments(part["sums"])
        )
        seen = RangeImage(part["viewpoint_m"], part["nearest_m"])
        side = RangeImage(part["side_m"], part["side_nearest_m"])
        return Record(
            T_given_own=part["T_given_own"],
            strays=int(part["strays"]),
            fine_tree=tree,
            range_image=seen if len(seen.nearest_m) else None,
            trust=float(part["trust"]),
            side=side if len(side.nearest_m) else None,
            seed=int(part["seed"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is no described scan: {error}") from error


def _check(part: dict[str, np.ndarray]) -> None:
    """Refuse what the compiled loops would read beyond: they ask nothing."""
    keys, images = part["keys"], (part["nearest_m"], part["side_nearest_m"])
    fits = (
        keys.dtype == np.int64
        and keys.ndim == 1
        and len(keys) > 0
        and bool((np.diff(keys) > 0).all())
        and part["sums"].shape == (len(keys), 10)
        and part["T_given_own"].shape == (4, 4)
        and all(part[name].shape == (3,) for name in ("origin_m", "viewpoint_m", "side_m"))
        and all(bins.ndim == 2 and bins.shape[0] == bins.shape[1] for bins in images)
        and part["voxel_size_m"] > 0
        and all(part[name].dtype.kind == "f" for name in _NUMBERS)
        and all(np.isfinite(part[name]).all() for name in _NUMBERS)
    )
    if not fits:
        raise ValueError("its arrays do not fit each other")
