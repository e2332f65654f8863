"""Keypoints of a scan as the matcher takes them, each with where it lies in the scan."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from skipnet.features.cylinders import choose_keypoints
from skipnet.features.frames import tangent_frames
from skipnet.networks.on_grids import OnGrids
from skipnet.parallel.threads import one_blas_thread
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import IntArray

MAX_KEYPOINTS = 400
"""Voxels of a scan that the matcher looks at; its time grows with their square. Of 119 pairs it
proposes a pose near the truth in 95, with 512 in 97, with 320 in 93."""
BOTH_SIDES_SHARE = 2 / 3
"""Of these, where each is described from both sides."""


class Tokens(NamedTuple):
    """K keypoints of a scan; arrays of NumPy at work, tensors while the matcher learns."""

    units: Any
    """(K, U) the deep network's hidden units."""
    places_voxels: Any
    """(K, 3) in voxels, about their mean, along the scan's axes."""
    axes: Any
    """(K, 3) unit axes of the surfaces there, in the same frame."""


@one_blas_thread
def tokens_of(
    skipmap: SkipMap, network: OnGrids, both_sides: bool, count: int = MAX_KEYPOINTS
) -> tuple[IntArray, Tokens]:
    """The keypoints of a scan, described by a deep network.

    Args:
        skipmap: the scan's Skip-map.
        network: a deep one.
        both_sides: describe each voxel with both signs of its axis; the second half are opposed.
        count: voxels described, see ``choose_keypoints``; a third fewer from both sides.

    Returns:
        (K,) rows of the Skip-map, and K tokens.
    """
    shown = int(BOTH_SIDES_SHARE * count) if both_sides else count
    rows = choose_keypoints(skipmap, shown, network.curved_share)
    grids = network.cut(skipmap, rows)
    axes = tangent_frames(skipmap, rows)[:, :, 0]
    if both_sides:
        grids = np.concatenate([grids, network.turned_over(grids)])
        rows, axes = np.concatenate([rows, rows]), np.concatenate([axes, -axes])
    places_m = skipmap.centroids_m[rows] - skipmap.centroids_m[rows].mean(axis=0)
    places_voxels = (places_m / skipmap.voxel_size_m).astype(np.float32)
    return rows, Tokens(network.units(grids), places_voxels, axes.astype(np.float32))
