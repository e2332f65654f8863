"""Depth images: 16-bit PNG files with the camera's intrinsics in a file beside them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.camera import find_camera
from skipnet.types import FloatArray

_MOST_PIXELS = 1 << 26


def read_depth(path: Path) -> Iterator[Cloud]:
    """The points of a depth image, x to the right, y down, z ahead of the camera at the origin.

    The intrinsics are a JSON or YAML file with fx, fy, cx, cy or a matrix (``intrinsic_matrix``,
    ``K``, ``camera_matrix``), and perhaps ``depth_scale``, units per metre; or a text file of a
    matrix. Pixels of depth 0 saw nothing.

    Raises:
        ValueError: no image of depths, or none of its intrinsics.
        FileNotFoundError: there are no intrinsics.
    """
    depth = _read_image(path)
    matrix, per_metre = find_camera(path)
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
