"""One scan made ready for registration: its Skip-map at three levels and what is read off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.features.primitives import Planes, find_planes
from skipnet.registration.verification import Evidence, build_evidence
from skipnet.registration.viewpoint import find_viewpoint
from skipnet.skipmap.skipmap import SkipMap, skipmap_of_tree
from skipnet.skipmap.tree import SkipTree, build_tree
from skipnet.types import FloatArray

Viewpoint = str | FloatArray | list[float] | None
"""Sensor position (3,) in the scan's frame, None when unknown, or "auto" to find out."""


@dataclass(frozen=True)
class Scan:
    """A described scan; every member is in the scan's own frame."""

    skipmap: SkipMap
    """At the voxel size: what features, hypotheses and verification use."""
    coarse: SkipMap
    """At twice the voxel size: where fine alignment starts."""
    fine_tree: SkipTree
    """At half the voxel size: where fine alignment ends."""
    evidence: Evidence
    """For the judge."""
    planes: Planes

    @property
    def viewpoint_m(self) -> FloatArray | None:
        """(3,) where it was taken from; None when that is unknown."""
        return self.skipmap.viewpoint_m

    def fine_skipmap(self) -> SkipMap:
        """The Skip-map at half the voxel size, built when asked for."""
        return skipmap_of_tree(self.fine_tree, self.viewpoint_m)


def describe(
    points_m: FloatArray, voxel_size_m: float, viewpoint: Viewpoint, rng: np.random.Generator
) -> Scan:
    """Build a scan's Skip-maps, find out its viewpoint and read off its planes.

    Args:
        points_m: (N, 3) points.
        voxel_size_m: edge of a voxel at the middle level.
        viewpoint: see ``Viewpoint``.
        rng: draws the order in which the judge samples voxels.
    """
    fine_tree = build_tree(points_m, voxel_size_m / 2)
    tree = fine_tree.coarser()
    skipmap = skipmap_of_tree(tree)
    if isinstance(viewpoint, str):
        viewpoint = find_viewpoint(skipmap)
    skipmap = skipmap.seen_from(None if viewpoint is None else np.asarray(viewpoint, np.float64))
    return Scan(
        skipmap=skipmap,
        coarse=skipmap_of_tree(tree.coarser(), skipmap.viewpoint_m),
        fine_tree=fine_tree,
        evidence=build_evidence(skipmap, points_m, rng),
        planes=find_planes(skipmap),
    )
