"""Depth images: 16-bit PNG files with the camera's intrinsics in a file beside them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.types import FloatArray

_UNITS_PER_METRE = 1000.0
"""Depth cameras count millimetres, unless the intrinsics say otherwise."""
_MOST_PIXELS = 1 << 26
_NAMES = ("{stem}.json", "intrinsics.json", "camera-intrinsics.txt", "intrinsics.txt")
"""Looked for beside the image, then one folder above."""


def read_depth(path: Path) -> Iterator[Cloud]:
    """The points of a depth image, x to the right, y down, z ahead of the camera at the origin.

    The intrinsics are a JSON file with fx, fy, cx, cy or ``intrinsic_matrix`` (Open3D's, column by
    column), and perhaps ``depth_scale``, units per metre; or a text file of a 3x3 matrix. Pixels of
    depth 0 saw nothing.

    Raises:
        ValueError: no image of depths, or none of its intrinsics.
        FileNotFoundError: there are no intrinsics.
    """
    depth = _read_image(path)
    matrix, per_metre = _intrinsics(path)
    rows, columns = np.nonzero(depth)
    z_m = depth[rows, columns] / per_metre
    x_m = (columns - matrix[0, 2]) / matrix[0, 0] * z_m
    y_m = (rows - matrix[1, 2]) / matrix[1, 1] * z_m
    empty = depth.size - len(rows)
    yield Cloud(
        np.stack([x_m, y_m, z_m], axis=1),
        viewpoint_m=np.zeros(3),
        name=str(path),
        notes=(f"left out {empty:,} of {depth.size:,} pixels that saw nothing",) if empty else (),
    )


def _read_image(path: Path) -> FloatArray:
    from PIL import Image

    try:
        with Image.open(path, formats=["PNG"]) as image:
            width, height = image.size
            if not image.mode.startswith("I") or width * height > _MOST_PIXELS:
                raise ValueError(
                    f"an image of kind {image.mode}, {width} x {height}: expected depths of 16 bits"
                )
            return np.asarray(image, np.float64)
    except Exception as error:  # Pillow raises many kinds for a damaged image
        message = " ".join(str(error).split())[:160]
        raise ValueError(f"{path}: truncated or no depth image: {message}") from error


def _intrinsics(path: Path) -> tuple[FloatArray, float]:
    """The (3, 3) camera matrix and the units in a metre."""
    for folder in (path.parent, path.parent.parent):
        for name in _NAMES:
            file = folder / name.format(stem=path.stem)
            if file.is_file():
                return _read_intrinsics(file)
    raise FileNotFoundError(
        f"{path}: a depth image needs its camera's intrinsics: {path.stem}.json or intrinsics.json "
        'beside it, such as {"fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5, "depth_scale": 1000}'
    )


def _read_intrinsics(file: Path) -> tuple[FloatArray, float]:
    try:
        if file.suffix == ".txt":
            per_metre, matrix = _UNITS_PER_METRE, np.loadtxt(file)
        else:
            content = json.loads(file.read_text("utf-8"))
            per_metre = float(content.get("depth_scale", _UNITS_PER_METRE))
            matrix = np.array(_matrix_of(content), np.float64)
    except (ValueError, KeyError, TypeError, AttributeError, UnicodeDecodeError) as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{file}: cannot read the camera's intrinsics: {message}") from error
    usable = matrix.shape == (3, 3) and np.isfinite(matrix).all() and 0 < per_metre < np.inf
    if not usable or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise ValueError(f"{file}: expected a camera matrix of 3 x 3 numbers, fx and fy above 0")
    return matrix, per_metre


def _matrix_of(content: dict[str, object]) -> FloatArray:
    if "intrinsic_matrix" in content:
        return np.array(content["intrinsic_matrix"], np.float64).reshape(3, 3).T
    fx, fy, cx, cy = (np.float64(content[name]) for name in ("fx", "fy", "cx", "cy"))  # type: ignore[arg-type]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
