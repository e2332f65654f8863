"""The clouds that a registration writes: the source aligned, many scans merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.writing import writable, write_cloud, write_scans
from skipnet.results.inputs import Given
from skipnet.types import FloatArray

ALWAYS = ".ply"
"""The format that is always written."""
_MEMORY_FORMATS = (".npy", ".npz")
"""Formats of programs' own arrays, which nobody looks at: they come out as ``ALWAYS``."""


def output_names(stem: str, paths: Sequence[Path], wanted: str) -> list[str]:
    """The files that a cloud is written to.

    Args:
        stem: "aligned" or "merged".
        paths: the files that went in.
        wanted: an extension without its dot, or "auto": the one that all of ``paths`` have.

    Raises:
        ValueError: the wanted format has no writer.
    """
    extensions = {path.suffix.lower() for path in paths}
    if wanted != "auto":
        extensions = {f".{wanted.lower().lstrip('.')}"}
        if not writable(f"{stem}{min(extensions)}"):
            raise ValueError(f"format={wanted}: there is no writer for it")
    own = min(extensions) if len(extensions) == 1 else ALWAYS
    if not writable(f"{stem}{own}") or (wanted == "auto" and own in _MEMORY_FORMATS):
        own = ALWAYS
    return list(dict.fromkeys([f"{stem}{ALWAYS}", f"{stem}{own}"]))


def write_aligned(
    source: Given, target: Given, T_target_source: FloatArray, folder: Path, names: Sequence[str]
) -> None:
    """Write the source in the target's frame, with all that it holds, under each name.

    Unit, offset and coordinate system are the target's, whose frame it is.
    """
    frame = target.cloud
    for name in names:
        moved = (
            replace(
                piece.moved(T_target_source),
                unit=frame.unit,
                offset_m=frame.offset_m,
                crs=frame.crs,
            )
            for piece in source.pieces()
        )
        write_cloud(folder / name, moved)


def write_merged(
    placed: Sequence[Cloud],
    tints: Sequence[FloatArray],
    by_scan: bool,
    folder: Path,
    names: Sequence[str],
) -> None:
    """Write scans that are in one frame as one cloud; E57 keeps them apart.

    Args:
        placed: the scans.
        tints: (3,) a colour of each, 0..255.
        by_scan: colour them so; else only where not all have colours of their own.
        folder: to write to.
        names: of the files.
    """
    if by_scan or any(cloud.colour is None for cloud in placed):
        placed = [
            replace(cloud, colour=np.tile(np.rint(tint).astype(np.uint8), (len(cloud), 1)))
            for cloud, tint in zip(placed, tints, strict=True)
        ]
    first = placed[0]
    facts = {"unit": first.unit, "offset_m": first.offset_m, "crs": first.crs}
    for name in names:
        write_scans(folder / name, [replace(cloud, **facts) for cloud in placed])  # type: ignore[arg-type]
