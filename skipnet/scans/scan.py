"""One scan made ready for registration: its Skip-map at three levels and what is read off it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skipnet.clouds.cleaning import validate
from skipnet.features.fpfh import fpfh
from skipnet.features.keypoints import Corners, Lines, find_corners, find_lines
from skipnet.features.patches import feature_voxels
from skipnet.features.primitives import Planes, find_planes
from skipnet.geometry import transform_points
from skipnet.networks.describing import Keypoints, classify_voxels, describe_keypoints
from skipnet.networks.model import Model
from skipnet.networks.on_grids import OnGrids
from skipnet.networks.tokens import Tokens, tokens_of
from skipnet.scans.evidence import Evidence
from skipnet.scans.lattice import lattice_step_m
from skipnet.scans.record import Record
from skipnet.scans.sparse import Thinned, thin
from skipnet.scans.things import (
    FURNITURE_PLANE,
    LARGE_PLANE,
    Things,
    find_things,
    standing_out,
)
from skipnet.scans.worth import voxel_worth
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.skipmap import SkipMap
from skipnet.skipmap.tree import Points, SkipTree
from skipnet.types import BoolArray, FeatureClass, FloatArray, IntArray

MIN_RESOLVED = 0.75
"""Share of a scan's points in effective voxels of the finest level; dense scans have 0.8 and more,
scans of a few lines 0.1 to 0.7."""

NARROW = 0.7
"""A view is narrow where the mean of all directions to its voxels is longer: of a half space it is
0.5, of a cone of 60 degrees to each side 0.75, of cameras 0.9."""

TINY_M = 1e-9
"""What lies at the sensor itself, as what it gives where it saw nothing, is in no direction."""

MIN_TRUST = 0.5
"""Normals are turned to a sensor's place that is trusted so far; a half-trusted plane's side is as
likely wrong as right."""


@dataclass(frozen=True)
class AutoAt:
    """To be found out whether the sensor stood here, as "auto" does of the frame's origin."""

    place_m: tuple[float, float, float]
    """In the scan's frame: such as the offset of a LAS file, where its own frame began."""


Viewpoint = str | FloatArray | list[float] | AutoAt | None
"""Sensor position (3,) in the scan's frame, None when unknown, or "auto" to find out."""


@dataclass(frozen=True)
class FeatureVoxels:
    """The network's word on the K feature voxels of a scan."""

    rows: IntArray
    """(K,) rows of the Skip-map."""
    probabilities: FloatArray
    """(K, 5) of each FeatureClass; rows sum to 1."""

    @property
    def classes(self) -> IntArray:
        """(K,) the likeliest FeatureClass."""
        return self.probabilities.argmax(axis=1)


def checked(cloud: npt.ArrayLike | SkipTree, name: str) -> Points:
    """Refuse what is no scan, as ``skipnet.clouds.cleaning.validate`` does."""
    if isinstance(cloud, SkipTree):
        validate(cloud.centroids_m, name)
        return cloud
    return validate(cloud, name)


@dataclass(frozen=True)
class Scan:
    """A described scan, in the principal frame of its own points.

    Voxels laid in that frame move along with the scan, so the result of a registration does not
    depend on the frames in which the scans are given.
    """

    record: Record
    """What the rest was made of."""
    skipmap: SkipMap
    """At the voxel size: what features, hypotheses and verification use."""
    coarse: SkipMap
    """At twice the voxel size: where fine alignment starts."""
    fine_skipmap: SkipMap
    """At half the voxel size: where fine alignment ends."""
    evidence: Evidence
    """For the judge."""
    network: Model
    """What recognises and classifies its voxels."""
    described: dict[tuple[str, bool], Keypoints] = field(
        default_factory=dict, repr=False, compare=False
    )
    """What ``keypoints`` has worked out so far; every pair of which the scan is part has it."""
    tokens_described: dict[tuple[str, bool], tuple[IntArray, Tokens]] = field(
        default_factory=dict, repr=False, compare=False
    )
    """Likewise what ``tokens`` has."""

    def __getstate__(self) -> dict[str, object]:
        """The fields alone: what is worked out on demand holds trees of a library, and is again."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def T_given_own(self) -> FloatArray:
        """(4, 4) see ``Record``."""
        return self.record.T_given_own

    @property
    def fine_tree(self) -> SkipTree:
        """See ``Record``."""
        return self.record.fine_tree

    @property
    def viewpoint_m(self) -> FloatArray | None:
        """(3,) where it was taken from; None when that is unknown, or too doubtful for normals to
        be turned there: only the judge listens to such a place."""
        return self.skipmap.viewpoint_m

    @property
    def viewpoint_given_m(self) -> FloatArray | None:
        """(3,) the place whose evidence counts, as far as it is trusted, in the frame that the scan
        was given in; None when there is none."""
        image = self.record.range_image
        if image is None:
            return None
        return transform_points(self.T_given_own, image.viewpoint_m[None])[0]

    @property
    def rank(self) -> tuple[int, int, float]:
        """Orders scans by themselves alone: occupied voxels, then points, then spread."""
        moments = self.fine_tree.moments
        return len(moments), int(moments.count.sum()), float(moments.second.sum())

    @cached_property
    def fine_near(self) -> CellTable:
        """The row of ``fine_skipmap`` in or next to each of its cells."""
        fine = self.fine_skipmap
        return CellTable(fine.cells, fine.voxel_size_m, fine.origin_m, with_neighbours=True)

    @cached_property
    def planes(self) -> Planes:
        """The planes of the scan, heaviest first."""
        return find_planes(self.skipmap)

    @cached_property
    def fine_cells(self) -> CellTable:
        """The row of ``fine_tree`` in each of its cells."""
        fine = self.fine_tree
        return CellTable(fine.cells, fine.voxel_size_m, fine.origin_m)

    @cached_property
    def things(self) -> Things:
        """The small things that stand on its large planes."""
        out = standing_out(self.fine_tree, self.planes, LARGE_PLANE * len(self.skipmap))
        return find_things(self.fine_tree, self.fine_cells, out)

    @cached_property
    def off_furniture(self) -> BoolArray:
        """(V,) which voxels of ``fine_tree`` lie on none of its planes, be they of furniture."""
        return standing_out(self.fine_tree, self.planes, FURNITURE_PLANE * len(self.skipmap))

    @cached_property
    def things_on_furniture(self) -> Things:
        """The small things that stand on any of its planes."""
        return find_things(self.fine_tree, self.fine_cells, self.off_furniture)

    @property
    def is_sparse(self) -> bool:
        """Whether too few points lie on surfaces that the finest level resolves."""
        return self.fine_skipmap.counts.sum() < MIN_RESOLVED * self.fine_tree.moments.count.sum()

    @cached_property
    def is_narrow(self) -> bool:
        """Whether it shows one side of its sensor alone, as what cameras see and what LiDARs that
        do not turn, or whether that is not known: two such scans often share little."""
        if self.viewpoint_m is None or len(self.skipmap) == 0:
            return True
        line_m = self.skipmap.centroids_m - self.viewpoint_m
        range_m = np.maximum(np.linalg.norm(line_m, axis=1, keepdims=True), TINY_M)
        mean = (line_m / range_m).mean(axis=0)
        return float(np.linalg.norm(mean)) > NARROW

    @cached_property
    def lattice_step_m(self) -> float:
        """Edge of the lattice to which its points were rounded; 0 where they were not."""
        return lattice_step_m(self.fine_tree, self.T_given_own)

    @cached_property
    def thinned(self) -> Thinned:
        """What fine alignment of sparse scans needs."""
        return thin(self.fine_tree.centroids_m, self.skipmap.voxel_size_m)

    @cached_property
    def histograms(self) -> FloatArray:
        """(V, 33) FPFH of every voxel."""
        return fpfh(self.skipmap)

    @cached_property
    def features(self) -> FeatureVoxels:
        """The classified feature voxels; the network runs when they are first asked for."""
        rows = feature_voxels(self.skipmap)
        return FeatureVoxels(rows, classify_voxels(self.skipmap, rows, self.network))

    def keypoints(self, network: Model, both_sides: bool) -> Keypoints:
        """What ``describe_keypoints`` says, worked out when it is first asked for."""
        key = network.digest, both_sides
        if key not in self.described:
            self.described[key] = describe_keypoints(self.skipmap, network, both_sides)
        return self.described[key]

    def tokens(self, network: OnGrids, both_sides: bool) -> tuple[IntArray, Tokens]:
        """What ``tokens_of`` says, worked out when it is first asked for."""
        key = network.digest, both_sides
        if key not in self.tokens_described:
            self.tokens_described[key] = tokens_of(self.skipmap, network, both_sides)
        return self.tokens_described[key]

    @cached_property
    def corners(self) -> Corners:
        """The corners among the classified feature voxels."""
        classes = self.features.classes
        corner = classes <= FeatureClass.OTHER_CORNER
        return find_corners(
            self.skipmap,
            self.features.rows[corner],
            classes[corner],
            self.features.probabilities[corner].max(axis=1),
        )

    @cached_property
    def lines(self) -> Lines:
        """The straight edges among the classified feature voxels."""
        edge = self.features.classes == FeatureClass.EDGE
        return find_lines(self.skipmap, self.features.rows[edge])

    @cached_property
    def _worth(self) -> FloatArray:
        """(V,) what each voxel is worth to the judge; every pair asks for it."""
        return voxel_worth(self.skipmap, self.planes)

    def valued_evidence(self, feature_weight: float) -> Evidence:
        """The evidence, each voxel judged by what it is worth, those of edges and corners by so
        many times as much."""
        worth = self._worth
        if feature_weight != 1:
            worth, features = worth.copy(), self.features
            worth[features.rows[features.classes != FeatureClass.PLANE]] *= feature_weight
        return self.evidence.valued(worth)
