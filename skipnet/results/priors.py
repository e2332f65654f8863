"""A pose that the command line was given: in four rows, or in a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.types import FloatArray


def read_pose(given: Any) -> FloatArray:
    """The (4, 4) of four rows of four numbers, of a text file of such, or of a result.json.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it holds no numbers.
    """
    if not isinstance(given, str):
        try:
            return np.array(given, np.float64)
        except (ValueError, TypeError) as error:
            raise ValueError(f"prior={given}: expected four rows of four numbers") from error
    path = Path(given)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file with a pose")
    try:
        text = path.read_text("utf-8")
        if not text.lstrip().startswith(("{", "[")):
            return np.loadtxt(text.replace(",", " ").splitlines())
        content = json.loads(text)
        return np.array(content["T_target_source"] if isinstance(content, dict) else content, float)
    except (ValueError, KeyError, TypeError) as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(
            f"{path}: holds no pose of four rows of four numbers: {message}"
        ) from error
