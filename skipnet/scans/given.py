"""What a caller may give as a scan: points, a Cloud, a file, what other libraries hold."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import as_colour, settled_colour
from skipnet.clouds.formats.reading import read_cloud
from skipnet.scans.scan import AutoAt, Viewpoint, checked
from skipnet.skipmap.tree import Points, SkipTree

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
    scan = opened(scan, name)
    if isinstance(scan, SkipTree):
        return checked(scan, name), viewpoint
    if isinstance(viewpoint, str):
        viewpoint = viewpoint_of(scan)
    what = f"{name} ({scan.name})" if scan.name and scan.name != name else name
    return checked(scan.points_m, what), viewpoint


def viewpoint_of(cloud: Cloud) -> Viewpoint:
    """What "auto" means for a cloud: its own viewpoint; else to find out whether the sensor stood
    where its coordinates count from, the offset of a LAS file or the origin."""
    if cloud.viewpoint_m is not None:
        return cloud.viewpoint_m
    x, y, z = cloud.offset_m.tolist()
    return AutoAt((x, y, z)) if cloud.offset_m.any() else "auto"


def opened(scan: ScanLike, name: str) -> Cloud | SkipTree:
    """What was given as a Cloud, with what else it holds; voxels stay what they are.

    Args:
        scan: see ``ScanLike``. Further columns of an array are kept as ``column 4`` and so on.
        name: of a scan that has none.
    """
    if isinstance(scan, SkipTree | Cloud):
        return scan
    if isinstance(scan, str | os.PathLike):
        return read_cloud(scan)
    if hasattr(scan, "xyz"):
        return _of_laspy(scan, name)
    if hasattr(scan, "to_legacy"):
        scan = scan.to_legacy()  # Open3D's tensors; its other clouds hold doubles too
    if hasattr(scan, "points"):
        return _of_open3d(scan, name)
    if np.ma.is_masked(scan):
        raise ValueError(f"{name}: some numbers are masked: drop their points")
    try:
        array = np.asarray(scan.detach().cpu() if hasattr(scan, "detach") else scan)
    except ValueError as error:  # rows of different lengths
        raise ValueError(f"{name}: expected numbers of shape (N, 3): {error}") from error
    wider = array.ndim == 2 and 3 < array.shape[1] < array.shape[0]
    columns = {f"column {k + 1}": array[:, k] for k in range(3, array.shape[1])} if wider else {}
    return Cloud(array[:, :3] if wider else array, columns=columns, name=name)


def _of_laspy(las: Any, name: str) -> Cloud:
    has = set(getattr(las.point_format, "dimension_names", ()))
    colour = None
    if {"red", "green", "blue"} <= has:
        columns = [np.asarray(las[axis]) for axis in ("red", "green", "blue")]
        colour = settled_colour(as_colour(columns))
    intensity = np.asarray(las.intensity) if "intensity" in has else None
    return Cloud(
        np.asarray(las.xyz),
        colour=colour,
        intensity=intensity,
        offset_m=np.array(getattr(las, "header", las).offsets, np.float64),
        name=name,
    )


def _of_open3d(cloud: Any, name: str) -> Cloud:
    points_m = np.asarray(cloud.points)
    colours, normals = np.asarray(cloud.colors), np.asarray(cloud.normals)
    has_colours, has_normals = (len(one) == len(points_m) > 0 for one in (colours, normals))
    return Cloud(
        points_m,
        colour=np.rint(255 * colours).astype(np.uint8) if has_colours else None,
        normals=normals if has_normals else None,
        name=name,
    )


def check_viewpoint(viewpoint: Viewpoint, name: str) -> None:
    """Refuse what is no viewpoint.

    Raises:
        ValueError: neither "auto" nor None nor three finite coordinates.
    """
    if viewpoint is None or isinstance(viewpoint, AutoAt):
        return
    if isinstance(viewpoint, str) and viewpoint == "auto":
        return
    position_m = np.asarray(viewpoint)
    if position_m.shape != (3,) or position_m.dtype.kind not in "iuf":
        raise ValueError(
            f'{name}={viewpoint!r}: expected "auto", None or a position (3,) in metres'
        )
    if not np.isfinite(position_m).all():
        raise ValueError(f"{name}={viewpoint!r}: expected finite coordinates, or None if unknown")
