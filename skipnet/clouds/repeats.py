"""Points that are there more than once: a file merged with itself, tiles that overlap, a viewer's
export.

They tell nothing new, and make a scan look denser than it is: its voxels would be too small for
what it shows.
"""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray, IntArray

MIN_REPEATS = 0.3
"""Other points at each one's very place, on average, from which repeats are left out: rounding to
what a sensor resolves brings hardly two together."""
_MIN_MET = 10
"""Repeats in the sample that are no chance."""
_SAMPLE = 1 << 13
_MIX = np.array([1.0, np.sqrt(2.0), np.sqrt(3.0)])
"""No two of as many points as a scan has come to the same sum by chance."""


def first_of_each(points_m: FloatArray) -> IntArray | None:
    """Rows of the points without those that repeat an earlier one, in their order.

    Args:
        points_m: (N, 3) points of a scan.

    Returns:
        (D,) rows; None where hardly any repeat, which a sample tells: all are kept then. Of more
        than some million points a few repeats each go unnoticed, and do no harm.
    """
    count = len(points_m)
    rows = np.unique(np.random.default_rng(0).integers(max(count, 1), size=min(count, _SAMPLE)))
    met = len(rows) - len(np.unique(points_m[rows] @ _MIX))
    # A share of one in N / S of each point's repeats is in the sample.
    repeats = 2 * met * count / max(len(rows), 1) ** 2
    if met < _MIN_MET or repeats < MIN_REPEATS:
        return None
    _, first = np.unique(points_m @ _MIX, return_index=True)
    return np.sort(first)
