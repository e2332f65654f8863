"""What a caller may give as a scan: points, a Cloud, a file, what other libraries hold."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.reading import read_cloud
from skipnet.scans.scan import Viewpoint, checked
from skipnet.skipmap.tree import Points, SkipTree
from skipnet.types import FloatArray

ScanLike = npt.ArrayLike | Cloud | SkipTree | str | os.PathLike[str]
"""(N, 3) numbers or more columns; a Cloud; voxels; a file's path; a torch tensor, a point cloud of
Open3D or laspy."""


def taken(scan: ScanLike, viewpoint: Viewpoint, name: str, option: str) -> tuple[Points, Viewpoint]:
    """The checked points of what was given, and the sensor's position.

    Args:
        scan: see ``ScanLike``. Of an array with more columns the first three are x, y, z.
        viewpoint: as ``skipnet.register`` takes it; for "auto" a file's or a Cloud's own viewpoint
            is taken, where it has one.
        name: what to call the scan in the errors, such as "source".
        option: what to call the viewpoint there.

    Raises:
        ValueError: it is no cloud of finite points, or no file of one.
        FileNotFoundError: there is no such file.
    """
    check_viewpoint(viewpoint, option)
    if isinstance(scan, SkipTree):
        return checked(scan, name), viewpoint
    if isinstance(scan, str | os.PathLike):
        scan = read_cloud(scan)
        name = f"{name} ({scan.name})"
    if isinstance(scan, Cloud):
        known = scan.viewpoint_m is not None and isinstance(viewpoint, str)
        return checked(scan.points_m, name), scan.viewpoint_m if known else viewpoint
    return checked(_places(scan, name), name), viewpoint


def check_viewpoint(viewpoint: Viewpoint, name: str) -> None:
    """Refuse what is no viewpoint.

    Raises:
        ValueError: neither "auto" nor None nor three finite coordinates.
    """
    if viewpoint is None or (isinstance(viewpoint, str) and viewpoint == "auto"):
        return
    position_m = np.asarray(viewpoint)
    if position_m.shape != (3,) or position_m.dtype.kind not in "iuf":
        raise ValueError(
            f'{name}={viewpoint!r}: expected "auto", None or a position (3,) in metres'
        )
    if not np.isfinite(position_m).all():
        raise ValueError(f"{name}={viewpoint!r}: expected finite coordinates, or None if unknown")


def _places(points: Any, name: str) -> FloatArray:
    """(N, 3) of an array-like, of the tensors and clouds of other libraries."""
    if hasattr(points, "xyz"):  # laspy
        points = points.xyz
    elif hasattr(points, "points"):  # Open3D
        points = points.points
    elif hasattr(points, "detach"):  # torch
        points = points.detach().cpu()
    try:
        array = np.asarray(points)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"{name}: expected numbers of shape (N, 3): {error}") from error
    wider = array.ndim == 2 and 3 < array.shape[1] < array.shape[0]
    return array[:, :3] if wider else array
