"""What all pairs of scans of two groups say together of how the groups may lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.types import FloatArray, IntArray

LITTLE_OVERLAP = 0.1
"""Added to what agrees: of scans that share next to nothing a stray voxel says little."""


@dataclass(frozen=True)
class Testimony:
    """What pairs of scans say of C poses of some scans against others; every array is (C,)."""

    support: FloatArray
    """Sum over the pairs of the share of both scans' surfaces that agree."""
    excess: FloatArray
    """Sum over the pairs of the share that contradicts seen free space, beyond stray voxels."""
    worst: FloatArray
    """Largest excess of a single pair."""
    witnesses: IntArray
    """Pairs of which a share agrees that is worth mentioning."""
    closest: FloatArray
    """Largest share that agrees of a single pair."""

    @property
    def contradiction(self) -> FloatArray:
        """What contradicts, 0 to 1: of all that can be compared, or in a single pair."""
        pooled = self.excess / (self.support + LITTLE_OVERLAP)
        worst: FloatArray = np.maximum(pooled, self.worst)
        return worst
