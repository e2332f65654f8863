"""PTX, Leica's text format: scans as grids of beams, each with its scanner's place and pose."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.types import FloatArray

LINES_AT_ONCE = 1 << 18
"""Lines parsed in one go."""
_HEADER_LINES = 10
_ROUNDING, _LEAST_SCALE = 1e-3, 1e-4
_MET_NOTHING = re.compile(r"(\s*[-+]?0+(\.0*)?){3}\s+\S+\s*")


def read_ptx(path: Path) -> Iterator[Cloud]:
    """The scans of the file, one after the other, in the file's common frame.

    A beam that met nothing is a row of zeros and left out.

    Raises:
        ValueError: it is no PTX file or ends before its last beam.
    """
    with open(path, encoding="latin-1") as file:
        number = 0
        lines = (line for line in file if not line.isspace())
        while header := list(islice(lines, _HEADER_LINES)):
            beams, T_file_scan, scale = _read_header(header, path)
            cloud = _scaled(_read_scan(lines, beams, f"{path}: scan {number}"), scale)
            moved = cloud.moved(T_file_scan)
            is_moved = not np.array_equal(T_file_scan, np.eye(4))
            viewpoint_m = T_file_scan[:3, 3] if is_moved else None
            if len(moved):
                yield Cloud(**{**vars(moved), "viewpoint_m": viewpoint_m})
            number += 1
    if not number:
        raise ValueError(f"{path}: holds no points")


def _scaled(cloud: Cloud, scale: float) -> Cloud:
    if scale == 1:
        return cloud
    note = f"its transform scales by {scale:.6g}, as a change of unit does"
    return replace(cloud, points_m=scale * cloud.points_m, notes=(*cloud.notes, note))


def _read_header(lines: list[str], path: Path) -> tuple[int, FloatArray, float]:
    """The number of beams, the (4, 4) pose of the scan in the file's frame, and its scale."""
    rows = []
    for line in lines:
        try:
            rows.append([float(word) for word in line.split()])
        except ValueError:
            break
    if [len(row) for row in rows] != [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]:
        raise ValueError(
            f"{path}: truncated or not a PTX file: expected columns, rows, four lines of 3 numbers "
            "and four of 4 before the points"
        )
    columns, lines_of_beams = rows[0][0], rows[1][0]
    T_file_scan = np.array(rows[6:]).T
    scale = _scale(T_file_scan[:3, :3])
    T_file_scan[:3, :3] /= scale
    turn = T_file_scan[:3, :3]
    if not np.isfinite(T_file_scan).all() or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
        raise ValueError(f"{path}: damaged: the transform of a scan is no rigid motion")
    beams = columns * lines_of_beams
    if not (0 <= beams < 2**40 and beams == int(beams)):
        raise ValueError(f"{path}: damaged: a scan of {columns:g} x {lines_of_beams:g} beams")
    return int(beams), T_file_scan, scale


def _scale(turn: FloatArray) -> float:
    """By how much a matrix makes things larger; 1 for what hardly does."""
    with np.errstate(all="ignore"):
        scale = float(np.cbrt(np.linalg.det(turn)))
    usable = _LEAST_SCALE < scale < 1 / _LEAST_SCALE and abs(scale - 1) > _ROUNDING
    return scale if usable else 1.0


def _read_scan(file: Iterator[str], beams: int, name: str) -> Cloud:
    pieces: list[FloatArray] = []
    present = 0
    while present < beams:
        lines = list(islice(file, min(LINES_AT_ONCE, beams - present)))
        if not lines:
            raise ValueError(f"{name}: truncated: announces {beams} beams, holds {present}")
        table = _parse(lines, name)
        present += len(table)
        pieces.append(table[(table[:, :3] != 0).any(axis=1)])
    table = np.concatenate(pieces) if pieces else np.empty((0, 4))
    empty = beams - len(table)
    return Cloud(
        points_m=np.ascontiguousarray(table[:, :3]),
        intensity=table[:, 3],
        colour=np.clip(table[:, 4:7], 0, 255).astype(np.uint8) if table.shape[1] == 7 else None,
        name=name,
        notes=(f"left out {empty:,} of {beams:,} beams that met nothing",) if empty else (),
    )


def _parse(lines: list[str], name: str) -> FloatArray:
    widths = {len(line.split()) for line in lines}
    if widths == {4, 7}:  # beams that met nothing may come without their colours
        lines = [
            f"{line.rstrip()} 0 0 0" if _MET_NOTHING.fullmatch(line) else line for line in lines
        ]
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None)
    except ValueError as error:
        message = " ".join(str(error).split(";")[0].split())[:120]
        raise ValueError(f"{name}: truncated or damaged: {message}") from error
    if table.shape[1] not in (4, 7) or len(table) < len(lines):
        raise ValueError(f"{name}: expected lines of x y z intensity, perhaps red green blue")
    return table
