"""How well confidences agree with the shares that are right."""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray


def expected_calibration_error(confidence: FloatArray, right: FloatArray, bins: int = 10) -> float:
    """Mean gap between confidence and share of right results over equal bins, by their size.

    Guo et al., "On Calibration of Modern Neural Networks", ICML 2017, eq. 3.

    >>> expected_calibration_error(np.array([0.9, 0.9]), np.array([1.0, 0.0]))
    0.4
    """
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    gap = np.bincount(place, confidence, bins) - np.bincount(place, right, bins)
    return float(round(np.abs(gap).sum() / max(count.sum(), 1), 12))
