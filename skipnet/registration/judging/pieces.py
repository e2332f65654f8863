"""What is gone, piece by piece: what one scan has alone, where the other one's rays went on behind.

A bag on a seat is no thing of its own, but a part of the row of seats it lies on; what it differs
by from the same row without it is. So pieces are sought in what the two scans differ by.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skipnet.compiled import compiled
from skipnet.geometry import invert, transform_points
from skipnet.registration.judging.furnishing import count_again
from skipnet.scans.scan import Scan
from skipnet.scans.things import FEWEST_VOXELS, MOST_VOXELS, footing_of
from skipnet.skipmap.cells import cells_of
from skipnet.skipmap.connected import AROUND, WITHIN_TWO, connected
from skipnet.types import BoolArray, FloatArray, IntArray

OFF_PLANE_VOXELS, OFF_VOXEL_VOXELS = 0.7, 0.8
"""What lies so near the plane of a fine voxel about it, or that voxel's middle, is on the same
surface; in fine voxels."""
BESIDE_VOXELS, BEHIND_VOXELS = 0.6, 1.5
"""A place was looked through if all rays that pass by it so near end so far behind it ..."""
IS_LOOKED_THROUGH = 0.6
"""... and a piece if so many of its voxels were. Rays that end before it say nothing."""
FEW, MANY = (5, 0.6, 0.025), (12, 0.3, 0.1)
"""So many small pieces gone, so many for each thing that is there again, and such a share of all
that stands out, are most of what lies about. Where many are gone, fewer will do for each that is
there again: furniture that is the same is, too."""
MIN_PARTS, MOST_SHARE = 4, 0.45
"""So many pieces of any size gone, and such a share of all that stands out, are most of it."""
_HALF_SLICES = 2000
"""Rays are sorted by so many slices of the directions' x, twice."""
_HERE_AND_AROUND = np.concatenate([np.zeros((1, 3), dtype=np.int64), AROUND])


@dataclass(frozen=True)
class Pieces:
    """What two scans differ by in small pieces, and how many small things they have in common."""

    again: int
    """Things of either scan, on its furniture too, that the other one has at the same place; 0
    where hardly anything is gone."""
    gone_m: FloatArray
    """(G, 3) middles of pieces that one scan has alone, though the other sensor looked through
    their places, target frame."""
    parts_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(P, 3) as ``gone_m``, of pieces of any size, large ones, too."""
    share: float = 0.0
    """Of what stands out in either scan, gone or there again, the share that is gone."""

    @staticmethod
    def none() -> Pieces:
        """Where nobody asked."""
        return Pieces(0, np.zeros((0, 3)))

    @property
    def is_most_gone(self) -> bool:
        """Of all that stands out, small and large, hardly more than a half is in both scans."""
        return len(self.parts_m) >= MIN_PARTS and self.share > MOST_SHARE

    @property
    def is_another(self) -> bool:
        """Most of what lies about in either scan is not in the other one."""
        gone = len(self.gone_m)
        return self.is_most_gone or any(
            gone >= least and gone > per_again * self.again and self.share > share
            for least, per_again, share in (FEW, MANY)
        )


def compare_pieces(T_target_source: FloatArray, source: Scan, target: Scan) -> Pieces:
    """Look for what either scan has alone under a (4, 4) pose.

    Where a sensor's place is not known nobody can tell what it looked through.
    """
    if source.viewpoint_m is None or target.viewpoint_m is None:
        return Pieces.none()
    T_source_target = invert(T_target_source)
    *there_m, there = _gone(T_target_source, source, target)
    *back_m, back = _gone(T_source_target, target, source)
    gone_m, parts_m = (
        np.concatenate([one_m, transform_points(T_target_source, other_m)])
        for one_m, other_m in zip(there_m, back_m, strict=True)
    )
    again = 0
    if len(gone_m) >= FEW[0]:  # else it does not matter
        again = count_again(T_target_source, source, target)
        again += count_again(T_source_target, target, source)
    voxels, others = there + back
    return Pieces(again, gone_m, parts_m, float(voxels / max(voxels + others, 1)))


def _gone(T_b_a: FloatArray, a: Scan, b: Scan) -> tuple[FloatArray, FloatArray, IntArray]:
    """(G, 3) middles of a's small pieces that are gone, b's frame, (P, 3) of those of any size, and
    (2,) how many voxels are gone, and how many that stand out are not."""
    tree, alone = a.fine_tree, _has_alone(T_b_a, a, b)
    rows, others = np.flatnonzero(alone), int(a.off_furniture.sum() - alone.sum())
    if len(rows) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.array([0, others])
    # Large things in parts, as scan lines leave them, are one: a step further than those touch.
    near = a.fine_cells.find_around(tree.cells[rows], WITHIN_TWO)
    of = connected(near, rows, len(tree))
    order = np.argsort(of, kind="stable")
    rows, of, near = rows[order], of[order], near[order]
    starts, sizes = np.flatnonzero(np.diff(of, prepend=-1)), np.bincount(of)
    points_m = transform_points(T_b_a, tree[rows].centroids_m)
    through = _is_looked_through(points_m, b)
    gone = np.bincount(of, through) >= IS_LOOKED_THROUGH * sizes
    gone &= sizes >= FEWEST_VOXELS
    low, high = (part.reduceat(tree.cells[rows], starts) for part in (np.minimum, np.maximum))
    lies_about = (high - low).max(axis=1) < MOST_VOXELS
    lies_about &= footing_of(near, of, alone, len(sizes)) >= sizes
    middle_m = np.add.reduceat(points_m, starts) / sizes[:, None]
    return middle_m[gone & lies_about], middle_m[gone], np.array([through.sum(), others])


def _has_alone(T_b_a: FloatArray, a: Scan, b: Scan) -> BoolArray:
    """(V,) which voxels of a's fine tree stand out, and lie on no surface of b."""
    alone = a.off_furniture.copy()
    fine, tree, voxel_m = b.fine_skipmap, b.fine_tree, b.fine_tree.voxel_size_m
    rows = np.flatnonzero(alone)
    points_m = transform_points(T_b_a, a.fine_tree[rows].centroids_m)
    there = fine.table.find_moved(np.eye(4)[None], points_m)[0]
    far = ~_lies_on(there[:, None], points_m, fine.centroids_m, fine.normals, voxel_m)
    alone[rows[~far]] = False
    rows, points_m = rows[far], points_m[far]  # few: the rest is looked at all about them
    surfaces = fine.table.find_around(cells_of(points_m, voxel_m, fine.origin_m), _HERE_AND_AROUND)
    voxels = b.fine_cells.find_around(cells_of(points_m, voxel_m, tree.origin_m), _HERE_AND_AROUND)
    on = _lies_on(surfaces, points_m, fine.centroids_m, fine.normals, voxel_m)
    on |= _lies_at(voxels, points_m - tree.origin_m, tree.moments.sums, voxel_m)
    alone[rows[on]] = False
    return alone


@compiled
def _lies_on(
    near: IntArray,
    points_m: FloatArray,
    centroids_m: FloatArray,
    normals: FloatArray,
    voxel_m: float,
) -> BoolArray:
    """(K,) which of (K, 3) points lie on the plane of one of the (K, O) voxels near them."""
    on = np.zeros(len(near), dtype=np.bool_)
    for k in range(len(near)):
        for o in range(near.shape[1]):
            row, off_m = near[k, o], 0.0
            if row >= 0:
                for i in range(3):
                    off_m += normals[row, i] * (points_m[k, i] - centroids_m[row, i])
                on[k] |= abs(off_m) < OFF_PLANE_VOXELS * voxel_m
    return on


@compiled
def _lies_at(near: IntArray, points_m: FloatArray, sums: FloatArray, voxel_m: float) -> BoolArray:
    """(K,) which of (K, 3) points lie at the middle of one of the (K, O) voxels near them, by the
    (V, 10) sums of these (``Moments``), about the same origin."""
    at = np.zeros(len(near), dtype=np.bool_)
    for k in range(len(near)):
        for o in range(near.shape[1]):
            row, square_m2 = near[k, o], 0.0
            if row >= 0:
                for i in range(3):
                    square_m2 += (points_m[k, i] - sums[row, 1 + i] / sums[row, 0]) ** 2
                at[k] |= square_m2 < (OFF_VOXEL_VOXELS * voxel_m) ** 2
    return at


def _is_looked_through(points_m: FloatArray, b: Scan) -> BoolArray:
    """(N,) past which of (N, 3) points b's rays go on, and none of those nearby ends before."""
    assert b.viewpoint_m is not None
    voxel_m, rays_m = b.fine_tree.voxel_size_m, b.fine_tree.centroids_m - b.viewpoint_m
    points_m = points_m - b.viewpoint_m
    away_m, ranges_m = (
        np.maximum(np.linalg.norm(those_m, axis=1), voxel_m) for those_m in (points_m, rays_m)
    )
    ways = rays_m / ranges_m[:, None]
    slices = ((ways[:, 0] + 1) * _HALF_SLICES).astype(np.int16)
    order = np.argsort(slices, kind="stable")  # short numbers are sorted in no time
    wide, least_m = BESIDE_VOXELS * voxel_m / away_m, away_m + BEHIND_VOXELS * voxel_m
    rays = ways[order], ranges_m[order], slices[order]
    return _ends_behind(points_m / away_m[:, None], wide, least_m, *rays)


@compiled
def _ends_behind(
    asked: FloatArray,
    wide: FloatArray,
    least_m: FloatArray,
    ways: FloatArray,
    ranges_m: FloatArray,
    slices: IntArray,
) -> BoolArray:
    """(N,) whether there are rays about a direction, and all of them end behind.

    Args:
        asked: (N, 3) unit directions.
        wide: (N,) how far about each, in radians, for small angles.
        least_m: (N,) where behind begins.
        ways: (R, 3) unit directions of the rays.
        ranges_m: (R,) theirs.
        slices: (R,) how far along x their directions lie, in ``_HALF_SLICES``, ascending.
    """
    behind = np.zeros(len(asked), dtype=np.bool_)
    for n in range(len(asked)):
        first = np.searchsorted(slices, int((asked[n, 0] - wide[n] + 1) * _HALF_SLICES) - 1)
        last = int((asked[n, 0] + wide[n] + 1) * _HALF_SLICES) + 1
        for ray in range(first, len(ways)):
            if slices[ray] > last:
                break
            x, y = ways[ray, 0] - asked[n, 0], ways[ray, 1] - asked[n, 1]
            z = ways[ray, 2] - asked[n, 2]
            if x * x + y * y + z * z < wide[n] ** 2:
                behind[n] = ranges_m[ray] > least_m[n]
                if not behind[n]:
                    break
    return behind
