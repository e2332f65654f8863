"""E57 files, through pye57."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skipnet.checks import missing_package
from skipnet.types import FloatArray


def read_e57(path: Path) -> FloatArray:
    """All scans of the file, in the file's common frame."""
    try:
        import pye57
    except ModuleNotFoundError as error:
        raise missing_package(path, "pye57") from error
    axes = ("cartesianX", "cartesianY", "cartesianZ")
    try:
        file = pye57.E57(str(path))
        scans = [
            file.read_scan(index, ignore_missing_fields=True) for index in range(file.scan_count)
        ]
        return np.concatenate([np.stack([scan[axis] for axis in axes], axis=1) for scan in scans])
    except Exception as error:  # libE57Format has its own exception, raised through pybind11
        raise ValueError(f"{path}: truncated or not an E57 file: {error}") from error
