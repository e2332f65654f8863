"""The one judge: how well a candidate pose explains both scans, whoever proposed it.

A pose earns the share of each scan's voxels that land on the other scan's surface with agreeing
oriented normals, and pays for every voxel that lands where the other sensor saw free space. The
payment decides between look-alike poses: overlap alone cannot tell the four turns of a square room
apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert
from skipnet.skipmap.cells import CellIndex, cells_of, pack
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

_EMPTY_RANGE_M = 0.0
_NEIGHBOURS = [cell for cell in np.ndindex(3, 3, 3) if cell != (1, 1, 1)]
_STEPS = pack(np.array(sorted(_NEIGHBOURS, key=lambda c: np.abs(np.subtract(c, 1)).sum()))) - pack(
    np.ones(3, dtype=np.int64)
)
"""Key differences to the 26 neighbours, faces before edges before corners."""


@dataclass(frozen=True)
class RangeImage:
    """How far a sensor saw in every direction, on an octahedral map of the sphere."""

    viewpoint_m: FloatArray
    """(3,) sensor position in the scan's frame."""
    nearest_m: FloatArray
    """(B, B) nearest range seen in or next to each bin; 0 where nothing was seen."""

    def range_towards(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """For (..., 3) points: their range, and the nearest range seen that way (0 unknown)."""
        offset_m = points_m - self.viewpoint_m.astype(points_m.dtype)
        bins = len(self.nearest_m)
        seen_m = self.nearest_m.ravel()[octahedral_bin(offset_m, bins)]
        return np.sqrt(np.einsum("...i,...i->...", offset_m, offset_m)), seen_m


@dataclass(frozen=True)
class Evidence:
    """One scan made ready for judging."""

    points_m: FloatArray
    """(V, 3) float32 voxel centroids, scan frame."""
    normals: FloatArray
    """(V, 3) float32 unit normals."""
    weights: FloatArray
    """(V,) how much each voxel says; edges and corners more than planes."""
    order: IntArray
    """(V,) a fixed random order in which voxels are sampled."""
    oriented: bool
    """Normals point to the sensor, so opposite ones are different surfaces."""
    voxel_size_m: float
    origin_m: FloatArray
    near: CellIndex
    """Row of the nearest voxel for every cell on or next to the surface."""
    range_image: RangeImage | None
    """None when the viewpoint is unknown: judged without free space."""


@dataclass(frozen=True)
class Score:
    """The judge's figures for C candidates; every array is (C,)."""

    total: FloatArray
    """Overlap, discounted for violations: overlap * exp(-weight * violation), 0 to 1."""
    overlap: FloatArray
    """Mean of both ways' matched shares, 0 to 1."""
    violation: FloatArray
    """Mean of both ways' shares that contradict seen free space, 0 to 1."""


def build_evidence(
    skipmap: SkipMap,
    points_m: FloatArray,
    rng: np.random.Generator,
    weights: FloatArray | None = None,
) -> Evidence:
    """Prepare a scan for ``judge``.

    Args:
        skipmap: the scan's Skip-map.
        points_m: (N, 3) the scan itself, for its range image.
        rng: draws the sampling order.
        weights: (V,) weight of each voxel; default 1.
    """
    viewpoint_m = skipmap.viewpoint_m
    return Evidence(
        points_m=skipmap.centroids_m.astype(np.float32),
        normals=skipmap.normals.astype(np.float32),
        weights=np.asarray(np.ones(len(skipmap)) if weights is None else weights, dtype=np.float32),
        order=rng.permutation(len(skipmap)),
        oriented=viewpoint_m is not None,
        voxel_size_m=skipmap.voxel_size_m,
        origin_m=skipmap.origin_m,
        near=_index_near_cells(skipmap),
        range_image=None if viewpoint_m is None else build_range_image(points_m, viewpoint_m),
    )


def build_range_image(points_m: FloatArray, viewpoint_m: FloatArray) -> RangeImage:
    """Nearest range per direction, with as many bins as the scan's density fills.

    Each bin takes the nearest range of its 3x3 neighbours too, so that a surface seen at a grazing
    angle or a silhouette never looks like free space.

    Args:
        points_m: (N, 3) points of one scan.
        viewpoint_m: (3,) where they were seen from.
    """
    bins = int(np.clip(np.sqrt(len(points_m) / 4), 32, 256))
    offset_m = (points_m - viewpoint_m).astype(np.float32)
    range_m = np.sqrt(np.einsum("ij,ij->i", offset_m, offset_m))
    nearest_m = np.full(bins * bins, np.inf, dtype=np.float32)
    np.minimum.at(nearest_m, octahedral_bin(offset_m, bins), range_m)
    padded = np.pad(nearest_m.reshape(bins, bins), 1, constant_values=np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    nearest_m = windows.min(axis=(2, 3))
    nearest_m[np.isinf(nearest_m)] = _EMPTY_RANGE_M
    return RangeImage(np.asarray(viewpoint_m, dtype=np.float64), nearest_m)


def judge(
    T_target_source: FloatArray,
    source: Evidence,
    target: Evidence,
    samples: int,
    violation_weight: float,
    max_distance_voxels: float = 1.0,
    min_normal_cosine: float = 0.8,
) -> Score:
    """Score candidate poses by what both scans say about them.

    Args:
        T_target_source: (C, 4, 4) candidates.
        source: the source's evidence.
        target: the target's evidence.
        samples: voxels to look at in each scan; the first so many of its sampling order.
        violation_weight: how fast contradictions devalue a pose; at 1 / weight of all voxels
            its overlap counts for 37 % (1 / e).
        max_distance_voxels: largest distance from the other scan's local plane.
        min_normal_cosine: smallest cosine between matching normals.
    """
    limits = (max_distance_voxels, min_normal_cosine)
    match_s, violation_s = _one_way(T_target_source, source, target, samples, *limits)
    match_t, violation_t = _one_way(invert(T_target_source), target, source, samples, *limits)
    overlap, violation = 0.5 * (match_s + match_t), 0.5 * (violation_s + violation_t)
    return Score(overlap * np.exp(-violation_weight * violation), overlap, violation)


def shortlist(
    T_target_source: FloatArray,
    source: Evidence,
    target: Evidence,
    violation_weight: float,
    count: int = 20,
    rounds: tuple[tuple[int, int], ...] = ((24, 2000), (100, 400), (400, 100)),
) -> FloatArray:
    """Judge all with few samples, the better ones with more; keep the best distinct ones.

    Args:
        T_target_source: (C, 4, 4) candidates.
        source: the source's evidence.
        target: the target's evidence.
        violation_weight: as in ``judge``.
        count: candidates to keep at the end.
        rounds: (samples, candidates that stay) of each round.

    Returns:
        (K, 4, 4) candidates, best first, no two within three voxels and three degrees.
    """
    for samples, stay in rounds:
        total = judge(T_target_source, source, target, samples, violation_weight).total
        T_target_source = T_target_source[np.argsort(-total, kind="stable")[:stay]]
    kept = distinct(T_target_source, source.points_m, 3 * source.voxel_size_m)
    return T_target_source[kept[:count]]


def distinct(
    T_target_source: FloatArray,
    source_m: FloatArray,
    min_distance_m: float,
    min_angle_rad: float = 0.05,
) -> IntArray:
    """Rows of the poses that differ from every better one before them.

    Args:
        T_target_source: (C, 4, 4) candidates, best first.
        source_m: (V, 3) source points; their centre shows how far two poses are apart.
        min_distance_m: poses that move the centre apart by more are distinct ...
        min_angle_rad: ... and so are those turned by more.
    """
    centre_m = source_m.mean(axis=0, dtype=np.float64)
    moved_m = T_target_source[:, :3, :3] @ centre_m + T_target_source[:, :3, 3]
    min_trace = 1 + 2 * np.cos(min_angle_rad)
    left, kept = np.arange(len(T_target_source)), []
    while len(left):
        best = left[0]
        kept.append(best)
        trace = np.einsum("cij,ij->c", T_target_source[left, :3, :3], T_target_source[best, :3, :3])
        apart_m = np.linalg.norm(moved_m[left] - moved_m[best], axis=1)
        left = left[(trace < min_trace) | (apart_m > min_distance_m)]
    return np.array(kept, dtype=np.int64)


def _one_way(
    T_b_a: FloatArray,
    a: Evidence,
    b: Evidence,
    samples: int,
    max_distance_voxels: float,
    min_normal_cosine: float,
) -> tuple[FloatArray, FloatArray]:
    """Weighted shares of a's voxels that match b and that violate b's free space, (C,) each."""
    chosen = a.order[:samples]
    rotation = T_b_a[:, :3, :3].astype(np.float32)
    weights = a.weights[chosen]
    points_b_m = a.points_m[chosen] @ rotation.transpose(0, 2, 1)
    points_b_m += T_b_a[:, None, :3, 3].astype(np.float32)
    row = b.near.find(pack(cells_of(points_b_m, b.voxel_size_m, b.origin_m.astype(np.float32))))
    normals_b = a.normals[chosen] @ rotation.transpose(0, 2, 1)
    cosine = np.einsum("csi,csi->cs", normals_b, b.normals[row])
    if not (a.oriented and b.oriented):
        cosine = np.abs(cosine)
    distance_m = np.einsum("csi,csi->cs", points_b_m - b.points_m[row], b.normals[row])
    match = (row >= 0) & (cosine > min_normal_cosine)
    match &= np.abs(distance_m) <= max_distance_voxels * b.voxel_size_m
    share = match @ (weights / weights.sum())
    if b.range_image is None:
        return share, np.zeros_like(share)
    range_m, seen_m = b.range_image.range_towards(points_b_m)
    free = range_m < 0.97 * seen_m - 2.5 * b.voxel_size_m
    return share, (free & ~match) @ (weights / weights.sum())


def _index_near_cells(skipmap: SkipMap) -> CellIndex:
    """For each cell within one step of an effective voxel the voxel fewest steps away."""
    index = CellIndex(skipmap.keys)
    row = np.arange(len(skipmap))
    for step in _STEPS:
        index.insert(skipmap.keys + step, row)
    return index


def octahedral_bin(offset_m: FloatArray, bins: int) -> IntArray:
    """Flat bin of each (..., 3) direction on the octahedron unfolded to a square."""
    scale = np.abs(offset_m).sum(axis=-1)
    scale[scale == 0] = 1
    u, v = offset_m[..., 0] / scale, offset_m[..., 1] / scale
    below = offset_m[..., 2] < 0
    folded_u, folded_v = np.copysign(1 - np.abs(v), u), np.copysign(1 - np.abs(u), v)
    u, v = np.where(below, folded_u, u), np.where(below, folded_v, v)
    column = np.minimum(((u + 1) * (bins / 2)).astype(np.int64), bins - 1)
    line = np.minimum(((v + 1) * (bins / 2)).astype(np.int64), bins - 1)
    return line * bins + column
