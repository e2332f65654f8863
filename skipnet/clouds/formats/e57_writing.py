"""Writing E57, with the bindings that pye57 brings: its own writer keeps coordinates in single
precision, which is half a metre on a map.

Format: ASTM E2807, with the extension for normals.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.e57 import OWN_COLUMNS
from skipnet.storage import replacing

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
_NORMALS_URI = "http://www.libe57.org/E57_NOR_surface_normals.txt"
_WHOLE = ("rowIndex", "columnIndex", "returnIndex", "returnCount")
_STATES = ("cartesianInvalidState", "sphericalInvalidState")


def write_e57(path: Path, scans: Iterable[Cloud]) -> None:
    """Write each cloud as a scan of its own, posed at its viewpoint; whole or not at all."""
    scans = list(scans)
    with replacing(path) as temporary:
        temporary.unlink()
        file = open_e57(temporary, next((cloud.crs for cloud in scans), ""))
        try:
            for cloud in scans:
                name = Path(cloud.name.rpartition(": ")[2]).name
                add_scan(file, _columns(cloud), name, cloud.viewpoint_m)
        finally:
            file.close()


def open_e57(path: Path, crs: str = "") -> Any:
    """A new E57 file without scans, to be closed."""
    from pye57 import libe57

    file = libe57.ImageFile(str(path), "w")
    file.extensionsAdd("", libe57.E57_V1_0_URI)
    file.extensionsAdd("nor", _NORMALS_URI)
    file.extensionsAdd(OWN_COLUMNS.rstrip(":"), "urn:skipnet:columns")
    root = file.root()
    root.set("formatName", libe57.StringNode(file, "ASTM E57 3D Imaging Data File"))
    root.set("guid", libe57.StringNode(file, f"{{{uuid.uuid4()}}}"))
    root.set("versionMajor", libe57.IntegerNode(file, libe57.E57_FORMAT_MAJOR))
    root.set("versionMinor", libe57.IntegerNode(file, libe57.E57_FORMAT_MINOR))
    root.set("coordinateMetadata", libe57.StringNode(file, crs))
    root.set("data3D", libe57.VectorNode(file, True))
    root.set("images2D", libe57.VectorNode(file, True))
    return file


def add_scan(
    file: Any,
    columns: Mapping[str, np.ndarray],
    name: str,
    place_m: np.ndarray | None = None,
    rotation: tuple[float, float, float, float] = (1, 0, 0, 0),
) -> None:
    """Add a scan to an open file.

    Args:
        file: of ``open_e57``.
        columns: (N,) numbers by the names that E57 gives them, in the scan's own frame.
        name: of the scan.
        place_m: (3,) the scan's own origin in the frame of the file; None writes no pose.
        rotation: of the scan in the file, as a quaternion w, x, y, z.
    """
    from pye57 import libe57

    scan = libe57.StructureNode(file)
    scan.set("guid", libe57.StringNode(file, f"{{{uuid.uuid4()}}}"))
    scan.set("name", libe57.StringNode(file, name))
    _set_limits(file, scan, columns)
    if place_m is not None:
        pose = libe57.StructureNode(file)
        scan.set("pose", pose)
        pose.set("rotation", _floats(file, dict(zip("wxyz", rotation, strict=True))))
        pose.set("translation", _floats(file, dict(zip("xyz", place_m, strict=True))))
    prototype = libe57.StructureNode(file)
    for field, values in columns.items():
        prototype.set(field, _kind_of(file, field, values))
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scan.set("points", points)
    file.root()["data3D"].append(scan)
    arrays = {field: _as_kept(field, values) for field, values in columns.items()}
    buffers, count = libe57.VectorSourceDestBuffer(), len(next(iter(arrays.values())))
    for field, values in arrays.items():
        buffers.append(libe57.SourceDestBuffer(file, field, values, count, True, True))
    writer = points.writer(buffers)
    writer.write(count)
    writer.close()


def _columns(cloud: Cloud) -> dict[str, np.ndarray]:
    place_m = np.zeros(3) if cloud.viewpoint_m is None else cloud.viewpoint_m
    columns = dict(zip(_CARTESIAN, (cloud.points_m - place_m).T, strict=True))
    if cloud.intensity is not None:
        columns["intensity"] = np.asarray(cloud.intensity)
    if cloud.colour is not None:
        columns |= dict(zip(_COLOURS, cloud.colour.T, strict=True))
    if cloud.normals is not None:
        columns |= dict(zip(_NORMALS, cloud.normals.T, strict=True))
    return columns | {_field(name): values for name, values in cloud.columns.items()}


def _field(name: str) -> str:
    """What a column is called in the file, which takes letters, digits and few signs."""
    if name in (*_WHOLE, "timeStamp"):
        return name
    return OWN_COLUMNS + re.sub("[^A-Za-z0-9_.-]", "_", name if name[:1].isalpha() else f"_{name}")


def _as_kept(field: str, values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.longlong if _is_whole(field, values) else np.float64)


def _is_whole(field: str, values: np.ndarray) -> bool:
    if field in _COLOURS or field in _STATES or field in _WHOLE:
        return True
    return field.startswith(OWN_COLUMNS) and values.dtype.kind in "iub"


def _kind_of(file: Any, field: str, values: np.ndarray) -> Any:
    """The node that says how a column is kept: whole numbers in few bits, others as doubles."""
    from pye57 import libe57

    if field in _COLOURS or field in _STATES:
        return libe57.IntegerNode(file, 0, 0, _brightest(values) if field in _COLOURS else 2)
    if _is_whole(field, values):
        low, high = int(np.min(values, initial=0)), int(np.max(values, initial=0))
        return libe57.IntegerNode(file, low, low, high)
    return libe57.FloatNode(file, 0.0, libe57.E57_DOUBLE)


def _brightest(colours: np.ndarray) -> int:
    return 65535 if colours.dtype == np.uint16 else 255


def _floats(file: Any, values: Mapping[str, float]) -> Any:
    from pye57 import libe57

    node = libe57.StructureNode(file)
    for name, value in values.items():
        node.set(name, libe57.FloatNode(file, float(value)))
    return node


def _set_limits(file: Any, scan: Any, columns: Mapping[str, np.ndarray]) -> None:
    """The ranges of intensity and colour, from which readers scale them."""
    from pye57 import libe57

    if "intensity" in columns:
        values = np.asarray(columns["intensity"], np.float64)
        ends = {"intensityMinimum": values.min(), "intensityMaximum": values.max()}
        scan.set("intensityLimits", _floats(file, ends))
    if _COLOURS[0] in columns:
        limits = libe57.StructureNode(file)
        for colour in _COLOURS:
            limits.set(f"{colour}Minimum", libe57.IntegerNode(file, 0))
            limits.set(f"{colour}Maximum", libe57.IntegerNode(file, _brightest(columns[colour])))
        scan.set("colorLimits", limits)
