"""What agrees between two scans that would not, were one of them of another room.

Walls, floors and doors agree in every alike room. What stands out from them, furniture above all,
tells which room it is, as far as hardly another scan agrees with it where both look alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.sameness import same_place
from skipnet.projects.ways import PairKey
from skipnet.scans.scan import Scan
from skipnet.scans.things import LARGE_PLANE, standing_out
from skipnet.skipmap.cells import cells_of
from skipnet.skipmap.connected import AROUND
from skipnet.types import BoolArray, FloatArray, IntArray

ALIKE = 0.3
"""A scan that agrees so far with another one elsewhere than where it stands looks like it there."""
FEW_ALIKE = 2
"""Of what fewer others look like nobody knows how many rooms have it."""
COMMON = 0.1
"""What so many of those others have, too, is common."""
THROUGH_SHARE, THROUGH_VOXELS = 0.01, 0.5
"""A sensor looked through what is nearer by this share of the range and so many voxels."""
_HERE_AND_AROUND = np.concatenate([np.zeros((1, 3), dtype=np.int64), AROUND])


class Peculiarities:
    """Compares what stands out in pairs of scans."""

    def __init__(self, scans: Sequence[Scan], joiner: Joiner) -> None:
        """Prepare to compare; nothing is worked out before it is asked for.

        Args:
            scans: all of them.
            joiner: knows which pairs look alike under which poses.
        """
        self._scans = scans
        self._joiner = joiner
        self._out: dict[int, BoolArray] = {}
        self._again: dict[tuple[int, int, int], BoolArray] = {}

    def agreeing(self, group: Group, key: PairKey) -> int:
        """Fine voxels that stand out in one scan of a pair and are there again in the other, less
        those that are not though it looked through their places; the less of both ways.

        Only those count that are not common among the other scans where these look alike, as door
        frames are.

        Args:
            group: where both stand.
            key: the pair.
        """
        T = invert(group.poses[key[0]]) @ group.poses[key[1]]
        ways = (key, T), (key[::-1], invert(T))
        return min(self._one_way(group, b, a, T_b_a) for (b, a), T_b_a in ways)

    def _one_way(self, group: Group, b: int, a: int, T_b_a: FloatArray) -> int:
        """As ``agreeing``, of a's voxels."""
        counts = self._is_rare(group, a)
        again, is_there = self._find(b, a, T_b_a)
        gone = np.zeros(len(again), dtype=bool)
        image = self._scans[b].evidence.range_image
        if image is not None:
            points_m = self._points_m(a).astype(np.float32)
            free_m = THROUGH_VOXELS * self._joiner.witness.voxel_size_m
            gone = image.in_front(T_b_a[None], points_m, ~is_there[None], THROUGH_SHARE, free_m)[0]
        return int(counts[again].sum()) - int(counts[gone].sum())

    def _is_rare(self, group: Group, scan: int) -> BoolArray:
        """(N,) which of the voxels that stand out in a scan few of the others have, too, where they
        look alike and do not stand; none where that cannot be told."""
        alike = [
            again
            for key in self._joiner.proposals
            if scan in key and (again := self._again_in_another(group, scan, key)) is not None
        ]
        if len(alike) < FEW_ALIKE:
            return np.zeros(len(self._rows(scan)), dtype=bool)
        return np.asarray(np.mean(alike, axis=0) < COMMON)

    def _again_in_another(self, group: Group, scan: int, key: PairKey) -> BoolArray | None:
        """(N,) which voxels are in the other scan of a pair wherever it looks alike and does not
        stand; None where it nowhere does."""
        pair = self._joiner.proposals[key]
        alike = pair.overlap >= ALIKE
        if key[0] in group.poses and key[1] in group.poses:
            T = invert(group.poses[key[0]]) @ group.poses[key[1]]
            alike &= ~same_place(self._joiner.witness, key[1], T, pair.T_target_source)
        if not alike.any():
            return None
        other = sum(key) - scan
        found = []
        for row in np.flatnonzero(alike):
            name = scan, other, int(row)
            if name not in self._again:
                T = pair.T_target_source[row]
                T_other_scan = invert(T) if key[0] == scan else T
                self._again[name] = self._find(other, scan, T_other_scan)[0]
            found.append(self._again[name])
        again: BoolArray = np.any(found, axis=0)
        return again

    def _find(self, b: int, a: int, T_b_a: FloatArray) -> tuple[BoolArray, BoolArray]:
        """(N,) which of a's voxels have such a one beside them in b, and which any at all."""
        tree = self._scans[b].fine_tree
        points_m = transform_points(T_b_a, self._points_m(a))
        cells = cells_of(points_m, tree.voxel_size_m, tree.origin_m)
        found = self._scans[b].fine_cells.find_around(cells, _HERE_AND_AROUND)
        is_there = found >= 0
        again = (is_there & self._stands_out(b)[found]).any(axis=1)
        return np.asarray(again), np.asarray(is_there.any(axis=1))

    def _points_m(self, scan: int) -> FloatArray:
        """(N, 3) the voxels that stand out, in the scan's own frame."""
        points_m: FloatArray = self._scans[scan].fine_tree.centroids_m[self._rows(scan)]
        return points_m

    def _rows(self, scan: int) -> IntArray:
        return np.flatnonzero(self._stands_out(scan))

    def _stands_out(self, scan: int) -> BoolArray:
        """(V,) see ``standing_out``."""
        if scan not in self._out:
            one = self._scans[scan]
            large = LARGE_PLANE * len(one.skipmap)
            self._out[scan] = standing_out(one.fine_tree, one.planes, large)
        return self._out[scan]
