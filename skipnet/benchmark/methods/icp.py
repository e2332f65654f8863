"""ICP as the paper compares against it: all points, from a given start (Open3D)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.checks import require_package
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.types import FloatArray

NORMAL_NEIGHBOURS = 30


def make(
    to_planes: bool = False,
    thin: bool = False,
    max_distance_m: float | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-6,
) -> Method:
    """ICP from ``T_target_source_start``.

    Args:
        to_planes: distances to the target's tangent planes (Chen and Medioni 1992) instead of to
            its points (Besl and McKay 1992).
        thin: on voxels of the size that skipnet chooses from the data, instead of on all points,
            which from a bad start takes minutes for dense scans.
        max_distance_m: correspondences farther apart are dropped; None keeps every nearest
            neighbour, as the original algorithm does.
        max_iterations: upper bound of the iterations.
        tolerance: it stops when fitness and inlier RMSE both change by less than this share.
    """
    o3d = require_package("open3d", "open3d")
    registration = o3d.pipelines.registration
    criteria = registration.ICPConvergenceCriteria(tolerance, tolerance, max_iterations)
    point_to_point = registration.TransformationEstimationPointToPoint()
    point_to_plane = registration.TransformationEstimationPointToPlane()
    reach_m = 1e6 if max_distance_m is None else max_distance_m

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        source, target = to_cloud(task.source_m), to_cloud(task.target_m)
        if thin:
            size_m = choose_voxel_size(task.source_m, task.target_m)
            source, target = (cloud.voxel_down_sample(size_m) for cloud in (source, target))
        if to_planes:
            target.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NORMAL_NEIGHBOURS))
        result = registration.registration_icp(
            source,
            target,
            reach_m,
            np.asarray(task.T_target_source_start, dtype=np.float64),
            point_to_plane if to_planes else point_to_point,
            criteria,
        )
        return Estimate(
            T_target_source=np.asarray(result.transformation),
            stage_s={"fine": time.perf_counter() - started},
            reason=f"{result.fitness:.0%} of the source matched, RMSE {result.inlier_rmse:.4f} m",
        )

    return run


def to_cloud(points_m: FloatArray) -> Any:
    """An Open3D point cloud of (N, 3) points."""
    import open3d as o3d

    return o3d.geometry.PointCloud(
        o3d.utility.Vector3dVector(np.ascontiguousarray(points_m, dtype=np.float64))
    )
