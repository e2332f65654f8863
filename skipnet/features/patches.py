"""Patches: what a feature voxel sees around it, as the paper's vector of 5 x 5 x 5 = 125 cells.

Two kinds. ``axis_aligned`` is the paper's: which of the 5x5x5 voxels of the Skip-map around the
feature are occupied, in the axes of the scan. ``surface_frame`` turns the cells into a frame that
the surfaces around the voxel define, so that a patch does not change when the scan is turned, and
the side that the sensor is on is always the same side of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

CELLS = 5
"""Cells along each axis of a patch."""
PATCH_SIZE = CELLS**3
CELL_VOXELS = 1.0
"""Edge of a cell of ``surface_frame``: 5 of them span what a label looks at."""
REACH_VOXELS = 3.5
"""Neighbours farther away than this are not looked at."""
FRAME_REACH_VOXELS = 2.5
"""Neighbours that define the frame."""
FLAT_CURVATURE = 0.02
"""Curvature at which a neighbour's normal counts half: across an edge it belongs to no surface."""
MASS_POWER = 1 / 3
"""A cell's value is its mass to this power: whether a surface just reaches a cell tells more than
how much of it lies there."""
UNDECIDED = 0.05
"""Mean normal along an axis below which the normals do not tell its two ends apart."""
MIN_CURVATURE = 0.01
"""A voxel is a feature when its curvature, or a neighbour's, is larger."""
KINDS = ("surface_frame", "axis_aligned")


def feature_voxels(skipmap: SkipMap, min_curvature: float = MIN_CURVATURE) -> IntArray:
    """Rows of the voxels whose patch can show more than one flat surface, ascending.

    The curvature of a voxel covers 3x3x3 voxels, the patch about 5x5x5: a voxel is a feature when
    any of its 26 neighbours, or itself, is curved.
    """
    curved = np.flatnonzero(skipmap.curvatures > min_curvature)
    near = skipmap.find_around(curved, _offsets_within(1.8))
    return np.unique(near[near >= 0]).astype(np.int64)


def build_patches(
    skipmap: SkipMap, voxel_indices: IntArray, kind: str = "surface_frame"
) -> FloatArray:
    """Describe voxels by what is around them.

    Args:
        skipmap: the scan. Without a viewpoint its normals may point either way; then a
            ``surface_frame`` patch no longer tells a concave corner from a convex one.
        voxel_indices: (K,) rows of the skip-map, such as ``feature_voxels`` returns.
        kind: "surface_frame" or "axis_aligned".

    Returns:
        (K, 125) float32.

    Raises:
        ValueError: an unknown kind, or rows that the skip-map does not have.
    """
    voxel_indices = np.asarray(voxel_indices, dtype=np.int64)
    if len(voxel_indices) and not 0 <= voxel_indices.min() <= voxel_indices.max() < len(skipmap):
        raise ValueError(f"voxel_indices must be rows of the skip-map, 0 to {len(skipmap) - 1}")
    if kind == "axis_aligned":
        return _axis_aligned(skipmap, voxel_indices)
    if kind == "surface_frame":
        return _surface_frame(skipmap, voxel_indices)
    raise ValueError(f"patch kind is {kind!r}; expected one of {', '.join(KINDS)}")


def _axis_aligned(skipmap: SkipMap, voxel_indices: IntArray) -> FloatArray:
    """1 for an occupied cell, 0 for an empty one; cells in the order x, y, z."""
    step = np.arange(CELLS) - CELLS // 2
    offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = skipmap.find_around(voxel_indices, offsets)
    return (rows >= 0).astype(np.float32)


def _surface_frame(skipmap: SkipMap, voxel_indices: IntArray) -> FloatArray:
    if len(voxel_indices) == 0:
        return np.zeros((0, PATCH_SIZE), dtype=np.float32)
    near = _neighbours(skipmap, voxel_indices)
    axes = surface_frames(near, oriented=skipmap.viewpoint_m is not None)
    local_voxels = np.einsum("pi,pij->pj", near.offsets_voxels, axes[near.owner])
    relative = near.counts / near.mean(near.counts)[near.owner]
    return _spread(local_voxels / CELL_VOXELS, np.log1p(relative), near) ** np.float32(MASS_POWER)


@dataclass(frozen=True)
class Neighbours:
    """All (voxel, neighbour) pairs of K voxels, sorted by voxel, each voxel with itself too."""

    owner: IntArray
    """(P,) row among the K voxels."""
    starts: IntArray
    """(K,) first pair of each voxel."""
    offsets_voxels: FloatArray
    """(P, 3) from the voxel's centroid to the neighbour's, in voxels, scan frame."""
    normals: FloatArray
    """(P, 3) the neighbours' unit normals."""
    flatness: FloatArray
    """(P,) trust in that normal: 1 on a flat surface, towards 0 across an edge."""
    counts: FloatArray
    """(P,) points in the neighbour."""

    def sum(self, values: FloatArray) -> FloatArray:
        """(K, ...) sums of (P, ...) values over each voxel's neighbours."""
        return np.add.reduceat(values, self.starts, axis=0)

    def mean(self, values: FloatArray) -> FloatArray:
        """(K,) means of (P,) values over each voxel's neighbours."""
        return self.sum(values) / np.diff(self.starts, append=len(self.owner))


def surface_frames(near: Neighbours, oriented: bool) -> FloatArray:
    """The frame of the surfaces around each voxel.

    The axes are the eigenvectors of sum(w n n^T) over the neighbours' normals n, most frequent
    direction first: three walls at right angles give their three normals. Every axis points to the
    side that the normals look to; an axis along which they do not look (along an edge), or all axes
    when the normals are not oriented, points to where more voxels are.

    Returns:
        (K, 3, 3), axes in columns; right- or left-handed, as the signs fall.
    """
    reach2 = np.einsum("pi,pi->p", near.offsets_voxels, near.offsets_voxels)
    inner = (reach2 < FRAME_REACH_VOXELS**2).astype(np.float32)
    weight = inner * near.flatness
    i, j = np.triu_indices(3)
    six = near.sum(weight[:, None] * near.normals[:, i] * near.normals[:, j])
    scatter = np.empty((len(six), 3, 3))
    scatter[:, i, j] = scatter[:, j, i] = six
    axes = np.linalg.eigh(scatter)[1][:, :, ::-1].astype(np.float32)
    lean = np.einsum("ki,kij->kj", near.sum(inner[:, None] * near.offsets_voxels), axes)
    if oriented:
        look = np.einsum("ki,kij->kj", near.sum(weight[:, None] * near.normals), axes)
        decided = np.abs(look) > UNDECIDED * near.sum(weight)[:, None]
        lean = np.where(decided, look, lean)
    return axes * np.where(lean < 0, -1, 1).astype(np.float32)[:, None]


def _neighbours(skipmap: SkipMap, voxel_indices: IntArray) -> Neighbours:
    found = skipmap.find_around(voxel_indices, _offsets_within(REACH_VOXELS))
    owner, place = np.nonzero(found >= 0)
    row = found[owner, place]
    gap_m = skipmap.centroids_m[row] - skipmap.centroids_m[voxel_indices[owner]]
    flatness = 1 / (1 + (skipmap.curvatures / FLAT_CURVATURE) ** 2)
    return Neighbours(
        owner=owner,
        starts=np.searchsorted(owner, np.arange(len(voxel_indices))),
        offsets_voxels=(gap_m / skipmap.voxel_size_m).astype(np.float32),
        normals=skipmap.normals.astype(np.float32)[row],
        flatness=flatness.astype(np.float32)[row],
        counts=skipmap.counts.astype(np.float32)[row],
    )


def _spread(local_cells: FloatArray, values: FloatArray, near: Neighbours) -> FloatArray:
    """Share each value among the eight cells around its place (trilinear); outside nothing counts.

    Sub-voxel positions survive that: the shares' centre of mass is the place itself.
    """
    rim = CELLS + 1  # a cell more on every side: what falls into it is lost
    places = np.clip(local_cells + rim // 2, 0, rim - 1e-4)
    cells = np.zeros((len(near.starts), CELLS, CELLS, CELLS))
    _share(places, values, near.owner, cells)
    return cells.reshape(-1, PATCH_SIZE).astype(np.float32)


@compiled
def _share(places: FloatArray, values: FloatArray, owner: IntArray, cells: FloatArray) -> None:
    """Add (P,) values to the cells about (P, 3) places, from 1 to C, of each owner's (C, C, C)."""
    size = cells.shape[1]
    for p in range(len(places)):
        x, y, z = int(places[p, 0]), int(places[p, 1]), int(places[p, 2])
        for i in range(max(x, 1), min(x + 1, size) + 1):
            for j in range(max(y, 1), min(y + 1, size) + 1):
                for k in range(max(z, 1), min(z + 1, size) + 1):
                    share = (1 - abs(places[p, 0] - i)) * (1 - abs(places[p, 1] - j))
                    share *= (1 - abs(places[p, 2] - k)) * values[p]
                    cells[owner[p], i - 1, j - 1, k - 1] += share


def _offsets_within(radius_voxels: float) -> IntArray:
    """(O, 3) cells whose centres lie within ``radius_voxels`` of the middle cell's."""
    reach = int(np.ceil(radius_voxels))
    step = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(step, step, step, indexing="ij"), axis=-1).reshape(-1, 3)
    return offsets[(offsets**2).sum(axis=1) <= radius_voxels**2]
