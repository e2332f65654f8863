"""The camera of a depth image: its intrinsics in a file beside it, in the forms that people use."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.types import FloatArray

_UNITS_PER_METRE = 1000.0
"""Depth cameras count millimetres, unless the intrinsics say otherwise."""
_STEMS = ("{stem}", "intrinsics", "camera-intrinsics", "camera_intrinsics", "intrinsic",
          "intrinsic_depth", "camera_intrinsic", "camera", "camera_info", "K", "cam_K")  # fmt: skip
_NAMES = tuple(f"{stem}{end}" for stem in _STEMS for end in (".json", ".yaml", ".txt"))
"""Looked for beside the image, then one folder above."""
_MATRICES = ("intrinsic_matrix", "camera_matrix", "K", "k", "cam_K", "intrinsics", "matrix", "data")
_SCALES = ("depth_scale", "scale", "depth_factor", "png_depth_scale")


def find_camera(path: Path) -> tuple[FloatArray, float]:
    """The (3, 3) matrix of an image's camera, and the units in a metre.

    Raises:
        FileNotFoundError: there is no file of intrinsics.
        ValueError: there is one, but no camera in it.
    """
    for folder in (path.parent, path.parent.parent):
        for name in _NAMES:
            file = folder / name.format(stem=path.stem)
            if file.is_file():
                return _read(file)
    raise FileNotFoundError(
        f"{path}: a depth image needs its camera's intrinsics: {path.stem}.json or intrinsics.json "
        'beside it, such as {"fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5, "depth_scale": 1000}'
    )


def _read(file: Path) -> tuple[FloatArray, float]:
    try:
        if file.suffix == ".txt":
            per_metre, matrix = _UNITS_PER_METRE, _square(np.loadtxt(file, delimiter=_mark(file)))
        else:
            content = _load(file)
            per_metre, matrix = _per_metre(content), _matrix_of(content)
    except (ValueError, KeyError, TypeError, AttributeError, UnicodeDecodeError) as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{file}: cannot read the camera's intrinsics: {message}") from error
    usable = matrix.shape == (3, 3) and np.isfinite(matrix).all() and 0 < per_metre < np.inf
    if not usable or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
        raise ValueError(f"{file}: expected a camera matrix of 3 x 3 numbers, fx and fy above 0")
    return matrix, per_metre


def _mark(file: Path) -> str | None:
    return "," if "," in file.read_text("utf-8") else None


def _load(file: Path) -> dict[str, Any]:
    text = file.read_text("utf-8")
    if file.suffix == ".json":
        return dict(json.loads(text))
    from omegaconf import OmegaConf

    try:
        return dict(OmegaConf.to_container(OmegaConf.create(text)))  # type: ignore[arg-type]
    except Exception as error:  # of PyYAML and OmegaConf, without a common base
        raise ValueError(f"not YAML: {error}") from error


def _per_metre(content: dict[str, Any]) -> float:
    """Units in a metre; a scale below 1 is the length of a unit, as some cameras give it."""
    found = next((content[name] for name in _SCALES if name in content), _UNITS_PER_METRE)
    scale = float(found)
    return 1 / scale if 0 < scale < 1 else scale


def _matrix_of(content: Any) -> FloatArray:
    """Of fx, fy, cx, cy, or of a matrix, perhaps one level down."""
    if not isinstance(content, dict):
        return _square(np.array(content, np.float64))
    if {"fx", "fy"} <= set(content):
        x, y = (content.get(f"c{axis}", content.get(f"pp{axis}")) for axis in "xy")
        fx, fy, cx, cy = map(float, (content["fx"], content["fy"], x, y))
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    name = next((name for name in _MATRICES if name in content), None)
    if name is not None:
        return _matrix_of(content[name])
    inner = [value for value in content.values() if isinstance(value, dict)]
    if len(inner) != 1:
        raise KeyError("fx")
    return _matrix_of(inner[0])


def _square(numbers: FloatArray) -> FloatArray:
    """(3, 3) of 3 x 3 or 4 x 4 numbers, of 9 row by row or column by column, of fx, fy, cx, cy."""
    numbers = np.asarray(numbers, np.float64)
    if numbers.shape == (4, 4):
        return numbers[:3, :3]
    if numbers.size == 4:
        fx, fy, cx, cy = numbers.ravel()
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if numbers.size != 9:
        return numbers
    matrix = numbers.reshape(3, 3)
    return matrix if matrix[2, :2].any() == 0 else matrix.T
