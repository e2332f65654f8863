"""How the keypoints of a scan lie to each other: what no motion of the scan changes."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import FloatArray

RELATIONS = 7
"""What is told of two keypoints: the logarithm of their distance, three functions that fade with
it, the cosines between the line to the other and either axis, and the cosine between the axes."""
NEAR_VOXELS = 4.0
"""Unit of the logarithm."""
FADING_VOXELS = (6.0, 20.0, 60.0)
"""Distances over which the three fade; each is a tenth or a third of the last."""
APART_VOXELS = 0.5
"""Nearer ones have no line between them: a voxel, and itself turned over."""
RELATION_UNITS = 20
"""Units that turn relations into how much keypoints attend to each other."""


@compiled
def relations(
    places_voxels: FloatArray, axes: FloatArray, oriented: bool, table: FloatArray
) -> None:
    """Write (K, K, 7) how the second of two keypoints lies to the first.

    Args:
        places_voxels: (K, 3) float32.
        axes: (K, 3) float32, of length 1.
        oriented: whether the axes' signs tell something; else cosines are taken without theirs.
        table: to write to, float32.
    """
    for i in range(len(places_voxels)):
        for j in range(len(places_voxels)):
            x = places_voxels[j, 0] - places_voxels[i, 0]
            y = places_voxels[j, 1] - places_voxels[i, 1]
            z = places_voxels[j, 2] - places_voxels[i, 2]
            far = np.sqrt(x * x + y * y + z * z)
            unit = np.float32(1 / far) if far > APART_VOXELS else np.float32(0)
            own = (x * axes[i, 0] + y * axes[i, 1] + z * axes[i, 2]) * unit
            other = (x * axes[j, 0] + y * axes[j, 1] + z * axes[j, 2]) * unit
            cosine = axes[i, 0] * axes[j, 0] + axes[i, 1] * axes[j, 1] + axes[i, 2] * axes[j, 2]
            if not oriented:
                own, other, cosine = abs(own), abs(other), abs(cosine)
            fading = np.exp(-far / np.float32(FADING_VOXELS[2]))
            thrice = fading * fading * fading
            there = table[i, j]
            there[0] = np.log1p(far / np.float32(NEAR_VOXELS))
            there[1] = thrice * thrice * thrice * fading
            there[2] = thrice
            there[3] = fading
            there[4], there[5], there[6] = own, other, cosine
