"""NumPy files: one array of points, or an archive of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skipnet.types import FloatArray


def read_numpy(path: Path) -> FloatArray:
    try:
        array = np.load(path, allow_pickle=False)
        if isinstance(array, np.lib.npyio.NpzFile):
            array = _single_array(array, path)
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(f"{path}: truncated or not a NumPy file: {error}") from error
    except Exception as error:  # zipfile.BadZipFile and friends have no common base
        raise ValueError(f"{path}: truncated or not a NumPy archive: {error}") from error
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "iuf":
        raise ValueError(
            f"{path}: holds {array.dtype} of shape {array.shape}: expected (N, 3) numbers"
        )
    return array[:, :3].astype(np.float64)


def _single_array(archive: np.lib.npyio.NpzFile, path: Path) -> np.ndarray:
    name = (
        "points"
        if "points" in archive.files
        else archive.files[0]
        if len(archive.files) == 1
        else None
    )
    if name is None:
        raise ValueError(f"holds the arrays {archive.files}: expected one called 'points'")
    return archive[name]
