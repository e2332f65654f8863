"""Scans larger than comfortable: thinned voxel by voxel while they are read.

Whatever the file's size, no more is held than some chunks and the voxels found so far. Moments add
up, so merging chunks and doubling the voxels loses nothing but the points' places within a voxel,
and the Skip-maps of a registration are built from these voxels, as if from the points.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from skipnet.clouds.statistics import as_floats, bounds
from skipnet.skipmap.grouping import CELL_MAX
from skipnet.skipmap.tree import SkipTree, build_tree, merge_trees
from skipnet.types import FloatArray

MOST_VOXELS = 1 << 19
"""Voxels that stay: fifty for each one of a registration's Skip-map."""
FINEST_VOXEL_M = 2.0**-10
"""Where thinning starts: nearer than a scanner's noise, and without rounding when it is doubled."""
_POINTS_AT_ONCE = 1 << 17
"""Points of one tree: at the finest, each is a voxel of its own, of eight times its memory."""
_FULL = 1.25
"""Trees are merged when they have so many times the voxels that may stay."""


def thin_chunks(
    chunks: Iterable[FloatArray],
    name: str,
    most_voxels: int = MOST_VOXELS,
    finest_m: float = FINEST_VOXEL_M,
) -> SkipTree:
    """Read a scan into voxels, which double until they are few enough.

    Args:
        chunks: (n, 3) finite points each, at least one chunk.
        name: what to call the scan in the errors.
        most_voxels: to keep at most.
        finest_m: edge of the voxels to start with.

    Returns:
        The tree of at most ``most_voxels`` voxels, with the moments of all the points.

    Raises:
        ValueError: a point is NaN or infinite, or there is no chunk.
    """
    pending: list[SkipTree] = []
    level = 0
    origin_m = None
    for chunk_m in _pieces(chunks):
        if not np.isfinite(chunk_m).all():
            raise ValueError(f"{name}: holds NaN or infinite coordinates: drop those points")
        low_m, high_m = bounds(chunk_m)
        origin_m = np.round(0.5 * (low_m + high_m)) if origin_m is None else origin_m
        reach_m = np.abs([low_m - origin_m, high_m - origin_m]).max()
        level = max(level, int(np.ceil(np.log2(max(reach_m / (finest_m * CELL_MAX), 1)))))
        pending.append(build_tree(chunk_m, finest_m * 2**level, origin_m))
        if sum(map(len, pending)) > _FULL * most_voxels:
            pending, level = _merge(pending, most_voxels, finest_m, level)
    if not pending:
        raise ValueError(f"{name}: holds no points")
    pending, _ = _merge(pending, most_voxels, finest_m, level)
    return pending[0]


def _pieces(chunks: Iterable[FloatArray]) -> Iterator[FloatArray]:
    """Chunks in pieces of which each makes one tree."""
    for chunk_m in chunks:
        chunk_m = as_floats(chunk_m)
        for start in range(0, len(chunk_m), _POINTS_AT_ONCE):
            yield chunk_m[start : start + _POINTS_AT_ONCE]


def _merge(
    trees: list[SkipTree], most_voxels: int, finest_m: float, level: int
) -> tuple[list[SkipTree], int]:
    """One tree of all, at ``level`` or as much coarser as it takes; and its level."""
    behind = [level - round(np.log2(tree.voxel_size_m / finest_m)) for tree in trees]
    merged = merge_trees(
        [tree.coarser(by) if by else tree for tree, by in zip(trees, behind, strict=True)]
    )
    while len(merged) > most_voxels:
        merged, level = merged.coarser(), level + 1
    return [merged], level
