"""Descriptors matched and sifted as in SC2-PCR (Chen et al., CVPR 2022), then ICP to planes.

It is skipnet without planes, without a judge: what descriptors alone give. It hands out its
correspondences, so that descriptors can be compared by their inliers.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.benchmark.methods.icp import to_cloud
from skipnet.benchmark.methods.open3d import refine_to_planes
from skipnet.checks import require_package
from skipnet.features.fpfh import fpfh
from skipnet.features.matching import mutual_nearest
from skipnet.geometry import transform_points
from skipnet.networks.catalog import find_network
from skipnet.networks.describing import correspond
from skipnet.networks.model import Model
from skipnet.networks.names import SHIPPED
from skipnet.registration.hypotheses.correspondences import from_correspondences
from skipnet.registration.hypotheses.fitting import fit_transforms
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, skipmap_of_tree
from skipnet.skipmap.tree import build_tree
from skipnet.types import FloatArray

DESCRIPTORS = ("fpfh", "learned")
AGREEMENT_VOXELS = 1.5
"""Correspondences agree on a pose that brings their voxels nearer than this."""


def make(
    descriptor: str = "fpfh",
    voxel_size_m: float | None = None,
    max_correspondences: int = 1500,
    weights: str = SHIPPED,
) -> Method:
    """Mutual nearest neighbours, second-order compatibility, the pose with the most inliers, ICP.

    Args:
        descriptor: "fpfh" (Rusu 2009) or "learned", skipnet's own.
        voxel_size_m: size of the voxels that are described; None takes the size that skipnet
            chooses from the data.
        max_correspondences: the best of them enter the compatibility graph.
        weights: network of the learned one: a name or a file, as in ``registration.network``.
    """
    o3d = require_package("open3d", "open3d")
    if descriptor not in DESCRIPTORS:
        raise ValueError(f"descriptor={descriptor}: expected one of {', '.join(DESCRIPTORS)}")
    learned = find_network(weights)

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        size_m = voxel_size_m or choose_voxel_size(task.source_m, task.target_m)
        source = _skipmap(task.source_m, size_m, task.source_viewpoint_m)
        target = _skipmap(task.target_m, size_m, task.target_viewpoint_m)
        mapped = time.perf_counter()
        source_m, target_m = _match(
            None if descriptor == "fpfh" else learned, source, target, max_correspondences
        )
        T_coarse, inliers = most_consistent_pose(source_m, target_m, AGREEMENT_VOXELS * size_m)
        matched = time.perf_counter()
        clouds = to_cloud(source.centroids_m), _with_normals(o3d, target)
        T_fine = refine_to_planes(o3d, *clouds, T_coarse, size_m)
        return Estimate(
            T_target_source=T_fine,
            T_target_source_coarse=T_coarse,
            stage_s={
                "map": mapped - started,
                "transform": matched - mapped,
                "fine": time.perf_counter() - matched,
            },
            reason=f"{inliers} of {len(source_m)} correspondences agree, voxels of {size_m:g} m",
            correspondences=(source_m, target_m),
        )

    return run


def most_consistent_pose(
    source_m: FloatArray, target_m: FloatArray, max_distance_m: float
) -> tuple[FloatArray, int]:
    """The (4, 4) pose under which most of (K, 3) correspondences meet, fitted to those, and their
    number.

    Raises:
        ValueError: no three correspondences keep their distances.
    """
    poses = from_correspondences(source_m, target_m, np.ones(len(source_m)), max_distance_m)
    if len(poses) == 0:
        raise ValueError(f"no three of {len(source_m)} correspondences keep their distances")
    moved_m = transform_points(poses.T_target_source, source_m)
    meet = np.linalg.norm(moved_m - target_m, axis=2) < max_distance_m
    best = int(meet.sum(axis=1).argmax())
    count = int(meet[best].sum())
    if count < 3:
        return poses.T_target_source[best], count
    weights = meet[best][None].astype(np.float64)
    return fit_transforms(source_m[None], target_m[None], weights)[0], count


def _skipmap(points_m: FloatArray, size_m: float, viewpoint_m: FloatArray | None) -> SkipMap:
    return skipmap_of_tree(build_tree(points_m, size_m)).seen_from(viewpoint_m)


def _match(
    learned: Model | None, source: SkipMap, target: SkipMap, most: int
) -> tuple[FloatArray, FloatArray]:
    """(K, 3) voxels of both scans that may be the same, the most alike first; None takes FPFH."""
    if learned is None:
        rows_s, rows_t, distance = mutual_nearest(fpfh(source), fpfh(target))
    else:
        rows_s, rows_t, distance = correspond(source, target, learned)
    best = np.argsort(distance, kind="stable")[:most]
    return source.centroids_m[rows_s[best]], target.centroids_m[rows_t[best]]


def _with_normals(o3d: Any, skipmap: SkipMap) -> Any:
    cloud = to_cloud(skipmap.centroids_m)
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(skipmap.normals, dtype=np.float64))
    return cloud
