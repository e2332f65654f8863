"""One scan made ready for the judge."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from skipnet.scans.range_image import RangeImage
from skipnet.scans.viewpoint import sides
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import BoolArray, FloatArray, IntArray

CLEAR_CURVATURE = 0.06
"""An edge of 90 degrees has 0.1 and more, noise of 20 % of a voxel 0.05."""


@dataclass(frozen=True)
class Evidence:
    """One scan made ready for judging; its voxels are in a fixed random order."""

    points_m: FloatArray
    """(V, 3) float32 voxel centroids, scan frame, in the order in which they are sampled."""
    normals: FloatArray
    """(V, 3) float32 unit normals, likewise."""
    weights: FloatArray
    """(V,) float32 how much each voxel says, likewise; see ``skipnet.scans.worth``."""
    rates: FloatArray
    """(V,) float32 how readily each voxel is sampled, likewise ..."""
    arrivals: FloatArray
    """(V,) float32 ... and when it was: exponential times at these rates, ascending unless some are
    ``gathered``."""
    order: IntArray
    """(V,) row in the Skip-map of each voxel in this order."""
    sides: FloatArray
    """(V,) float32, likewise: how surely each normal points to the side that was seen, 0 to 1; for
    what it is worth, a surface with the opposite normal is another one."""
    trust: float
    """What the viewpoint's word on free space is worth: 0 without one, to 1."""
    clear: BoolArray
    """(V,) the voxel is flat enough for its normal to speak against a surface near it, likewise."""
    surfaces: FloatArray
    """(V, 5) float32 normal and offset of each voxel's plane and its side's sureness, in the
    Skip-map's order."""
    centroid_errors_voxels: FloatArray
    """(V,) deviation of each voxel's centroid along its normal, in the Skip-map's order."""
    near: CellTable
    """Row in ``surfaces`` of the voxel that a point lies on or next to."""
    clear_there: BoolArray
    """(V,) as ``clear``, in the Skip-map's order."""
    range_image: RangeImage | None
    """None when the viewpoint is unknown, or worth nothing: judged without free space."""
    prefixes: tuple[int, ...] | None = None
    """So many of the first voxels can be asked about; None for any number."""

    @property
    def voxel_size_m(self) -> float:
        """Edge of a voxel."""
        return self.near.voxel_size_m

    @cached_property
    def centre_m(self) -> FloatArray:
        """(3,) mean of the voxels."""
        return self.points_m.mean(axis=0, dtype=np.float64)

    def weighing(self, share: FloatArray) -> Evidence:
        """The same evidence, each voxel with (V,) a share of its say, in the Skip-map's order."""
        return replace(self, weights=(self.weights * share[self.order]).astype(np.float32))

    def valued(self, worth: FloatArray) -> Evidence:
        """The same evidence with (V,) weights above 0, in the Skip-map's order, sampled by them.

        Voxels arrive at exponential times, whose rates are their weights: the first so many are a
        weighted sample without replacement (Efraimidis & Spirakis 2006).
        """
        rates = worth[self.order]
        arrivals = self.arrivals * self.rates / rates
        rows = np.argsort(arrivals, kind="stable")
        sorted_rates = rates[rows].astype(np.float32)
        return replace(
            self,
            points_m=self.points_m[rows],
            normals=self.normals[rows],
            clear=self.clear[rows],
            sides=self.sides[rows],
            weights=sorted_rates,
            rates=sorted_rates,
            arrivals=arrivals[rows].astype(np.float32),
            order=self.order[rows],
            prefixes=None,
        )

    def gathered(self, prefixes: set[int]) -> Evidence:
        """The same evidence, the first so many voxels being the same for each of some numbers, and
        in the Skip-map's order between them: what lies side by side is looked up faster than what
        lies anywhere."""
        count = len(self.order)
        ends = sorted({0, *(min(prefix, count) for prefix in prefixes)})
        rows = np.arange(count)  # what comes after the last one stays
        for first, end in pairwise(ends):
            rows[first:end] = first + np.argsort(self.order[first:end])
        kept = ("points_m", "normals", "clear", "sides", "weights", "rates", "arrivals", "order")
        moved = {name: getattr(self, name)[rows] for name in kept}
        return replace(self, **moved, prefixes=tuple(sorted(prefixes)))

    def shares(self, samples: int) -> FloatArray:
        """(2, S) what the first so many voxels stand for, by number and by weight; all sum to 1.

        Raises:
            ValueError: none of the numbers by which the voxels were gathered.
        """
        if samples not in self._shares:
            self._shares[samples] = self._share(samples)
        return self._shares[samples]

    @cached_property
    def _shares(self) -> dict[int, FloatArray]:
        """By samples, as they are asked for."""
        return {}

    def _share(self, samples: int) -> FloatArray:
        """See ``shares``."""
        count = min(samples, len(self.points_m))
        if not (self.prefixes is None or count == len(self.points_m) or count in self.prefixes):
            raise ValueError(f"samples={samples}: expected one of {self.prefixes} or all voxels")
        chance = np.ones(count, dtype=np.float32)
        if samples < len(self.points_m):
            chance = -np.expm1(-self.rates[:count] * self.arrivals[count:].min())
        each = np.stack([np.ones(count, dtype=np.float32), self.weights[:count]]) / chance
        share: FloatArray = each / each.sum(axis=1, keepdims=True)
        return share


def build_evidence(
    skipmap: SkipMap,
    range_image: RangeImage | None,
    rng: np.random.Generator,
    trust: float = 1.0,
) -> Evidence:
    """Prepare a scan for the judge.

    Args:
        skipmap: the scan's Skip-map, seen from the range image's viewpoint, or, where there is
            none, from any place on the side that was seen; from nowhere if that is unknown.
        range_image: how far the sensor saw; None when its place is unknown.
        rng: draws the order in which voxels are sampled.
        trust: in that place, see ``skipnet.scans.viewpoint.trust_in``.
    """
    points, normals = (a.astype(np.float32) for a in (skipmap.centroids_m, skipmap.normals))
    offsets_m = np.einsum("vi,vi->v", points, normals)
    arrivals = rng.exponential(size=len(skipmap))
    order = np.argsort(arrivals, kind="stable")
    clear = skipmap.curvatures < CLEAR_CURVATURE
    sure = np.zeros(len(skipmap), dtype=np.float32)
    if skipmap.viewpoint_m is not None:
        sure = np.float32(trust) * sides(skipmap, skipmap.viewpoint_m)
    return Evidence(
        points_m=points[order],
        normals=normals[order],
        weights=np.ones(len(skipmap), dtype=np.float32),
        rates=np.ones(len(skipmap), dtype=np.float32),
        arrivals=arrivals[order].astype(np.float32),
        clear=clear[order],
        order=order,
        sides=sure[order],
        trust=0.0 if range_image is None else trust,
        surfaces=np.column_stack([normals, offsets_m, sure]),
        centroid_errors_voxels=centroid_errors_voxels(skipmap),
        near=CellTable(skipmap.cells, skipmap.voxel_size_m, skipmap.origin_m, with_neighbours=True),
        clear_there=clear,
        range_image=range_image,
    )


def centroid_errors_voxels(skipmap: SkipMap) -> FloatArray:
    """(V,) standard deviation of each voxel's centroid along its normal, in voxels."""
    deviation_m = np.sqrt(skipmap.eigenvalues_m2[:, 0] / skipmap.counts)
    return deviation_m / skipmap.voxel_size_m
