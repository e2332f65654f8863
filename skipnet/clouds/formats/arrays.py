"""NumPy files: an array of points, or an archive with one and perhaps more by the same rows."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.columns import as_colour, cloud_of_columns, columns_of_cloud, find_axes
from skipnet.clouds.formats.unnamed import name_columns
from skipnet.storage import replacing

_POINTS = ("points", "points_m", "xyz", "pts", "pos", "positions", "position", "coords", "coord",
           "coordinates", "vertices", "pcd", "pc", "cloud", "point_cloud", "pointcloud", "lidar",
           "velodyne", "data", "arr_0")  # fmt: skip
_COLOURS = ("colors", "colours", "color", "colour", "rgb")
_NORMALS = ("normals", "normal")
_INTENSITY = ("intensity", "intensities", "reflectance")
_VIEWPOINT = ("viewpoint_m", "viewpoint")
_WIDTHS = range(3, 11)
"""Numbers that an array has per point."""
_LARGEST_RATIO = 1100
"""Of what deflate packs; an archive that promises more is not read."""


def read_numpy(path: Path) -> Iterator[Cloud]:
    """The points of an .npy or .npz file with what stands beside them.

    Raises:
        ValueError: it is damaged, or no array in it can be points.
    """
    if zipfile.is_zipfile(path):
        yield _cloud_of_archive(read_archive(path), path)
        return
    yield _cloud_of_array(read_npy(path), path, {})


def read_npy(path: Path) -> np.ndarray:
    """The array of an .npy file, held against the bytes that there are.

    Raises:
        ValueError: it is damaged, or no such file.
    """
    with open(path, "rb") as file:
        return _read_array(file, path.stat().st_size, str(path))


def _read_array(file: IO[bytes], available: int, what: str) -> np.ndarray:
    """One array in NumPy's format, whose size is held against the bytes that there are."""
    try:
        version = np.lib.format.read_magic(file)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, fortran, dtype = read(file)
    except Exception as error:  # what tokenize, zlib and zipfile raise has no common base
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{what}: truncated or not a NumPy file: {message}") from error
    if dtype.hasobject:
        raise ValueError(f"{what}: holds Python objects, which are never read: expected numbers")
    if dtype.itemsize == 0:
        raise ValueError(f"{what}: holds {dtype}, which takes no room: expected numbers")
    bytes_ = math.prod(shape) * dtype.itemsize
    if bytes_ > available or min(shape, default=0) < 0:
        raise ValueError(f"{what}: truncated: announces {shape} {dtype}, which it does not hold")
    try:
        body = file.read(bytes_)
    except Exception as error:
        raise ValueError(f"{what}: damaged: {' '.join(str(error).split())[:120]}") from error
    if len(body) < bytes_:
        raise ValueError(f"{what}: truncated: announces {bytes_} bytes and holds {len(body)}")
    return np.frombuffer(body, dtype).reshape(shape, order="F" if fortran else "C")


def read_archive(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by name, each held against the bytes that there are.

    Raises:
        ValueError: it is damaged, or no such archive.
    """
    arrays = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if not member.filename.endswith(".npy"):
                    continue
                if member.file_size > _LARGEST_RATIO * max(member.compress_size, 1):
                    raise ValueError(f"{path}: damaged: {member.filename} unpacks to too much")
                with archive.open(member) as file:
                    name = member.filename.removesuffix(".npy")
                    arrays[name] = _read_array(file, member.file_size, f"{path}: {name}")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError) as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: truncated or not a NumPy archive: {message}") from error
    return arrays


def _cloud_of_archive(arrays: dict[str, np.ndarray], path: Path) -> Cloud:
    small = {name.lower(): name for name in reversed(arrays)}
    name = next((small[name] for name in _POINTS if name in small), None) or _only_points(arrays)
    if name is not None:
        points = arrays.pop(name)
        return _cloud_of_array(points, path, arrays)
    if len({array.shape for array in arrays.values()}) == 1 and find_axes(list(arrays)):
        arrays = {name: array.ravel() for name, array in arrays.items()}  # images of coordinates
    columns = {name: array for name, array in arrays.items() if array.ndim == 1}
    if find_axes(list(columns)) and len({len(array) for array in columns.values()}) == 1:
        _check_kinds(columns, path)
        beside = {name: array for name, array in arrays.items() if array.ndim > 1}
        return _with_what_is_beside(cloud_of_columns(columns, path), beside)
    if len(arrays) == 1:
        return _cloud_of_array(next(iter(arrays.values())), path, {})
    raise ValueError(
        f"{path}: holds the arrays {', '.join(arrays)[:120] or '(none)'}: expected one called "
        "'points'"
    )


def _only_points(arrays: Mapping[str, np.ndarray]) -> str | None:
    """The name of the one array that can be points, if there is no other."""
    known = {*_COLOURS, *_NORMALS}
    fitting = [
        name
        for name, array in arrays.items()
        if array.ndim == 2
        and array.shape[1] >= 3
        and array.shape not in ((3, 3), (4, 4), (3, 4))
        and array.dtype.kind in "iuf"
        and name.lower() not in known
    ]
    return fitting[0] if len(fitting) == 1 else None


def _check_kinds(columns: Mapping[str, np.ndarray], path: Path) -> None:
    for name, array in columns.items():
        if array.dtype.kind not in "iufb":
            raise ValueError(f"{path}: {name} holds {array.dtype}: expected numbers")


def _cloud_of_array(array: np.ndarray, path: Path, beside: dict[str, np.ndarray]) -> Cloud:
    """The cloud of an array of rows, of (H, W, 3) pixels, or of records with named fields."""
    if array.dtype.names:
        array = array.ravel()
        records = {name: array[name] for name in array.dtype.names or ()}
        if not find_axes(list(records)):
            return _cloud_of_archive(records, path)
        columns = {
            name: values
            for name, values in records.items()
            if values.dtype.kind in "iuf" and values.ndim == 1
        }
        beside = {name: values for name, values in records.items() if values.ndim > 1}
        return _with_what_is_beside(cloud_of_columns(columns, path), beside)
    array = _by_rows(array)
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "iuf":
        raise ValueError(
            f"{path}: holds {array.dtype} of shape {array.shape}: expected (N, 3) numbers"
        )
    if not len(array):  # what it says of columns was held against nothing
        raise ValueError(f"{path}: holds no points")
    table = array.astype(np.float64)
    names, notes = name_columns(table, path)
    cloud = cloud_of_columns(dict(zip(names, table.T, strict=True)), path, notes=notes)
    return _with_what_is_beside(cloud, beside)


def _by_rows(array: np.ndarray) -> np.ndarray:
    """(N, k) of (H, W, k) or (k, H, W) pixels, of (N, k) rows or (k, N) columns."""
    if array.ndim == 3 and array.shape[0] in _WIDTHS and min(array.shape[1:]) > max(_WIDTHS):
        array = np.moveaxis(array, 0, 2)
    if array.ndim == 3 and array.shape[2] in _WIDTHS:
        array = array.reshape(-1, array.shape[2])
    if array.ndim == 2 and array.shape[0] in _WIDTHS and array.shape[1] > max(_WIDTHS):
        array = array.T
    return array


def _with_what_is_beside(cloud: Cloud, beside: dict[str, np.ndarray]) -> Cloud:
    count = len(cloud)
    facts: dict[str, object] = {}
    columns = dict(cloud.columns)
    for own_name, array in beside.items():
        name = own_name.lower()
        per_point = array.dtype.kind in "iufb" and array.ndim and len(array) == count
        if per_point and array.shape == (count, 3) and name in _COLOURS:
            facts["colour"] = as_colour(list(array.T))
        elif per_point and array.shape == (count, 3) and name in _NORMALS:
            facts["normals"] = array.astype(np.float64)
        elif per_point and array.size == count and name in _INTENSITY:
            facts["intensity"] = array.ravel()
        elif per_point and array.ndim == 1:
            columns[own_name] = array
        elif name == "crs" and array.dtype.kind == "U" and array.ndim == 0:
            facts["crs"] = str(array)
        elif name in _VIEWPOINT and array.shape == (3,) and array.dtype.kind in "iuf":
            facts["viewpoint_m"] = array.astype(np.float64)
    return Cloud(**{**vars(cloud), "columns": columns, **facts})


def write_npy(path: Path, cloud: Cloud) -> None:
    """Write the points alone, (N, 3) float64, whole or not at all."""
    points = np.stack([columns_of_cloud(cloud)[axis] for axis in "xyz"], axis=1)
    with replacing(path) as temporary:
        np.save(temporary, points)


def write_npz(path: Path, cloud: Cloud) -> None:
    """Write points and what the cloud holds beside them, whole or not at all."""
    arrays = {
        "points": np.stack([columns_of_cloud(cloud)[axis] for axis in "xyz"], axis=1),
        "colors": cloud.colour,
        "normals": cloud.normals,
        "intensity": cloud.intensity,
        "viewpoint_m": cloud.viewpoint_m,
        "crs": np.array(cloud.crs) if cloud.crs else None,
        **cloud.columns,
    }
    with replacing(path) as temporary:
        np.savez(temporary, **{name: array for name, array in arrays.items() if array is not None})  # type: ignore[arg-type]
