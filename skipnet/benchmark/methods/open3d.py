"""FPFH features, RANSAC and point-to-plane ICP: the global registration of Open3D's tutorial."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task, require
from skipnet.benchmark.methods.icp import to_cloud
from skipnet.types import FloatArray

NORMAL_RADIUS_VOXELS = 2.0
FEATURE_RADIUS_VOXELS = 5.0
RANSAC_DISTANCE_VOXELS = 1.5
ICP_DISTANCE_VOXELS = 0.4
"""Multiples of the voxel size as in the tutorial."""


def make(
    voxel_size_m: float = 0.15, max_iterations: int = 100_000, confidence: float = 0.999
) -> Method:
    """FPFH (Rusu 2009) on voxels, RANSAC over feature matches, point-to-plane ICP.

    Open3D's RANSAC is not deterministic, not even with a seed: figures vary a little from run to
    run.

    Args:
        voxel_size_m: size of the voxels; every other length follows from it.
        max_iterations: upper bound of RANSAC's draws.
        confidence: probability of a good draw at which RANSAC stops earlier.
    """
    o3d = require("open3d", "open3d")
    criteria = o3d.pipelines.registration.RANSACConvergenceCriteria(max_iterations, confidence)

    def run(task: Task) -> Estimate:
        started = time.perf_counter()
        source, source_features = _describe(
            o3d, task.source_m, task.source_viewpoint_m, voxel_size_m
        )
        target, target_features = _describe(
            o3d, task.target_m, task.target_viewpoint_m, voxel_size_m
        )
        described = time.perf_counter()
        T_coarse = _ransac(
            o3d, source, target, source_features, target_features, voxel_size_m, criteria
        )
        matched = time.perf_counter()
        T_fine = _refine(o3d, source, target, T_coarse, ICP_DISTANCE_VOXELS * voxel_size_m)
        return Estimate(
            T_target_source=T_fine,
            T_target_source_coarse=T_coarse,
            stage_s={
                "map": described - started,
                "transform": matched - described,
                "fine": time.perf_counter() - matched,
            },
        )

    return run


def _describe(
    o3d: Any, points_m: FloatArray, viewpoint_m: FloatArray | None, voxel_size_m: float
) -> tuple[Any, Any]:
    cloud = to_cloud(points_m).voxel_down_sample(voxel_size_m)
    search = o3d.geometry.KDTreeSearchParamHybrid
    cloud.estimate_normals(search(radius=NORMAL_RADIUS_VOXELS * voxel_size_m, max_nn=30))
    if viewpoint_m is not None:
        cloud.orient_normals_towards_camera_location(viewpoint_m)
    features = o3d.pipelines.registration.compute_fpfh_feature(
        cloud, search(radius=FEATURE_RADIUS_VOXELS * voxel_size_m, max_nn=100)
    )
    return cloud, features


def _ransac(
    o3d: Any,
    source: Any,
    target: Any,
    source_features: Any,
    target_features: Any,
    voxel_size_m: float,
    criteria: Any,
) -> FloatArray:
    registration = o3d.pipelines.registration
    distance_m = RANSAC_DISTANCE_VOXELS * voxel_size_m
    result = registration.registration_ransac_based_on_feature_matching(
        source,
        target,
        source_features,
        target_features,
        True,
        distance_m,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(distance_m),
        ],
        criteria,
    )
    return np.asarray(result.transformation)


def _refine(o3d: Any, source: Any, target: Any, T_start: FloatArray, reach_m: float) -> FloatArray:
    registration = o3d.pipelines.registration
    result = registration.registration_icp(
        source, target, reach_m, T_start, registration.TransformationEstimationPointToPlane()
    )
    return np.asarray(result.transformation)
