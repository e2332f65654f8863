"""How good a descriptor is: right correspondences between scans whose motion is known."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.features.cylinders import choose_keypoints
from skipnet.features.fpfh import fpfh
from skipnet.features.frames import tangent_frames
from skipnet.features.matching import mutual_nearest
from skipnet.geometry import transform_points
from skipnet.networks.describing import correspond, describe_keypoints, matched
from skipnet.networks.model import Model
from skipnet.networks.numpy_matcher import NumpyMatcher
from skipnet.networks.on_grids import OnGrids
from skipnet.networks.tokens import tokens_of
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

INLIER_VOXELS = 2.0
"""A correspondence is right when the truth brings its voxels nearer than this."""
ENOUGH_INLIERS = 0.05
"""Share of right correspondences from which two scans count as matched (PPFNet, CVPR 2018)."""
LIKELY = 0.1
"""Probability from which a matcher's pair counts as a correspondence (as in LightGlue)."""
OVERLAP_LIMITS = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0)
SAME_PLACE_VOXELS = 0.7
"""Voxels of two scans show the same place when their centroids are nearer, and ..."""
SAME_PLACE_COSINE = 0.8
"""... their normals differ by less than the angle of this cosine."""


@dataclass(frozen=True)
class TwoScans:
    """Two degraded scans of a scene as Skip-maps of one voxel size, and the truth."""

    source: SkipMap
    target: SkipMap
    T_target_source: FloatArray
    """(4, 4)"""
    oriented: bool
    """Whether both were taken from one place each, so that their normals look to it."""


Correspond = Callable[[TwoScans], tuple[IntArray, IntArray]]
"""Rows of the source and of the target that a descriptor takes for the same places."""


@dataclass(frozen=True)
class Match:
    """What one descriptor made of one pair of scans."""

    inlier_ratio: float
    overlap: float
    """Share of the source's voxels that the target has too."""
    seconds: float
    """Of describing both scans and matching."""


def match(scans: TwoScans, find: Correspond) -> Match:
    """Let a descriptor find correspondences, against the clock, and count the right ones."""
    start_s = time.perf_counter()
    rows_s, rows_t = find(scans)
    seconds = time.perf_counter() - start_s
    return Match(inlier_ratio(scans, rows_s, rows_t), overlap_of(scans), seconds)


def overlap_of(scans: TwoScans) -> float:
    """Share of the source's voxels that the target has too."""
    return len(true_correspondences(scans)[0]) / len(scans.source)


def by_network(scans: TwoScans, descriptor: Model) -> tuple[IntArray, IntArray]:
    """The learned descriptor's correspondences."""
    return correspond(scans.source, scans.target, descriptor)[:2]


def by_matcher(
    scans: TwoScans, network: OnGrids, matcher: NumpyMatcher
) -> tuple[IntArray, IntArray]:
    """A matcher's likely correspondences between what a deep network describes."""
    source = tokens_of(scans.source, network, False)
    target = tokens_of(scans.target, network, not scans.oriented)
    rows_s, rows_t, unlikely = matched(matcher, source, target, scans.oriented)
    likely = unlikely <= -np.log(LIKELY)
    return rows_s[likely], rows_t[likely]


def by_fpfh(scans: TwoScans, keypoints: tuple[IntArray, IntArray]) -> tuple[IntArray, IntArray]:
    """FPFH's correspondences between (K,) rows of the source and (L,) rows of the target."""
    described_s, described_t = fpfh(scans.source), fpfh(scans.target)
    of_source, of_target, _ = mutual_nearest(described_s[keypoints[0]], described_t[keypoints[1]])
    return keypoints[0][of_source], keypoints[1][of_target]


def keypoints_of(scans: TwoScans, descriptor: Model) -> tuple[IntArray, IntArray]:
    """The rows of both scans between which the learned descriptor looks for correspondences."""
    rows_s, _ = describe_keypoints(scans.source, descriptor)
    rows_t, _ = describe_keypoints(scans.target, descriptor, both_sides=not scans.oriented)
    return rows_s, np.unique(rows_t)


def inlier_ratio(scans: TwoScans, rows_s: IntArray, rows_t: IntArray) -> float:
    """Share of correspondences that are right; 0 when there are none."""
    moved_m = transform_points(scans.T_target_source, scans.source.centroids_m[rows_s])
    apart_m = np.linalg.norm(moved_m - scans.target.centroids_m[rows_t], axis=1)
    return _share(apart_m / scans.source.voxel_size_m)


def _share(apart_voxels: FloatArray) -> float:
    return float((apart_voxels < INLIER_VOXELS).mean()) if len(apart_voxels) else 0.0


def summarise(matches: Sequence[Match]) -> dict[str, float]:
    """Mean inlier ratio, share of matched pairs, mean seconds, and the number of pairs."""
    ratios = np.array([one.inlier_ratio for one in matches])
    return {
        "inlier_ratio": float(ratios.mean()),
        "matched_pairs": float((ratios >= ENOUGH_INLIERS).mean()),
        "seconds": float(np.mean([one.seconds for one in matches])),
        "pairs": len(matches),
    }


def by_overlap(matches: Sequence[Match]) -> dict[str, dict[str, float]]:
    """``summarise`` for each range of overlap in which there are pairs."""
    groups: dict[str, list[Match]] = {range_of(low): [] for low in OVERLAP_LIMITS[:-1]}
    for one in matches:
        groups[range_of(one.overlap)].append(one)
    return {name: summarise(inside) for name, inside in groups.items() if inside}


def summarise_by_overlap(matches: Sequence[Match]) -> dict[str, dict[str, float]]:
    """``summarise`` of "all", and ``by_overlap``."""
    return {"all": summarise(matches), **by_overlap(matches)}


def range_of(overlap: float) -> str:
    """The range of ``OVERLAP_LIMITS`` in which it lies, in words.

    >>> range_of(0.15)
    '10% to 20%'
    """
    last = len(OVERLAP_LIMITS) - 1
    above = min(int(np.searchsorted(OVERLAP_LIMITS, overlap, side="right")), last)
    return f"{OVERLAP_LIMITS[above - 1]:.0%} to {OVERLAP_LIMITS[above]:.0%}"


@dataclass(frozen=True)
class Keypoints:
    """Patches of the keypoints of two scans, cut out once to be described again and again."""

    source: FloatArray
    """(K, ...)"""
    target: FloatArray
    """(L, ...)"""
    source_voxels: FloatArray
    """(K, 3) where the source's truly lie in the target's frame, in voxels."""
    target_voxels: FloatArray
    """(L, 3) where the target's lie."""
    overlap: float
    """Share of the source's voxels that the target has too."""

    @staticmethod
    def of(scans: TwoScans, descriptor: Model) -> Keypoints:
        """All those that are described: training shall do well on the less matchable ones too."""
        rows_s, rows_t = (
            choose_keypoints(s, descriptor.max_keypoints, descriptor.curved_share)
            for s in (scans.source, scans.target)
        )
        moved_m = transform_points(scans.T_target_source, scans.source.centroids_m[rows_s])
        patches_t, places_m = (
            descriptor.cut(scans.target, rows_t),
            scans.target.centroids_m[rows_t],
        )
        if not scans.oriented:
            patches_t = np.concatenate([patches_t, descriptor.turned_over(patches_t)])
            places_m = np.concatenate([places_m, places_m])
        size_m = scans.source.voxel_size_m
        return Keypoints(
            descriptor.cut(scans.source, rows_s),
            patches_t,
            moved_m / size_m,
            places_m / size_m,
            overlap_of(scans),
        )

    def inlier_ratio(self, descriptor: Model) -> float:
        """Share of right ones among the descriptor's correspondences."""
        rows_s, rows_t, _ = mutual_nearest(
            *(descriptor.read(p)[0] for p in (self.source, self.target))
        )
        gap_voxels = self.source_voxels[rows_s] - self.target_voxels[rows_t]
        return _share(np.linalg.norm(gap_voxels, axis=1))


def true_correspondences(scans: TwoScans) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of both scans that coincide under the truth.

    Returns:
        (C,) rows of the source, (C,) rows of the target, and (C,) 1 where their surfaces' axes
        agree, -1 where they are opposed; that can only be where the scans are not oriented.
    """
    from scipy.spatial import cKDTree

    source, target = scans.source, scans.target
    moved_m = transform_points(scans.T_target_source, source.centroids_m)
    reach_m = SAME_PLACE_VOXELS * source.voxel_size_m
    distance_m, nearest = cKDTree(target.centroids_m).query(moved_m, distance_upper_bound=reach_m)
    rows_s = np.flatnonzero(np.isfinite(distance_m))
    rows_t = nearest[rows_s]
    axes_s, axes_t = (
        tangent_frames(skipmap, rows)[:, :, 0]
        for skipmap, rows in ((source, rows_s), (target, rows_t))
    )
    cosine = np.einsum("ci,ci->c", axes_s @ scans.T_target_source[:3, :3].T, axes_t)
    agree = (cosine if scans.oriented else np.abs(cosine)) > SAME_PLACE_COSINE
    return rows_s[agree], rows_t[agree], np.sign(cosine[agree])
