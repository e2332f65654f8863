"""FPFH features, RANSAC or FGR, and point-to-plane ICP: the global registration of Open3D."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.benchmark.methods.icp import to_cloud
from skipnet.checks import require_package
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.types import FloatArray

NORMAL_RADIUS_VOXELS = 2.0
FEATURE_RADIUS_VOXELS = 5.0
RANSAC_DISTANCE_VOXELS = 1.5
FGR_DISTANCE_VOXELS = 0.5
ICP_DISTANCE_VOXELS = 0.4
"""Multiples of the voxel size as in the tutorial."""

Described = tuple[Any, Any]
"""An Open3D cloud and its features."""


def make(
    search: str = "ransac",
    voxel_size_m: float | None = None,
    max_iterations: int = 100_000,
    confidence: float = 0.999,
    seed: int = 0,
) -> Method:
    """FPFH (Rusu 2009) on voxels, a search over feature matches, point-to-plane ICP.

    Args:
        search: "ransac" (Fischler and Bolles 1981) or "fgr" (Zhou et al. 2016).
        voxel_size_m: size of the voxels; every other length follows from it. None takes the size
            that skipnet chooses from the data: Open3D itself has no default.
        max_iterations: upper bound of RANSAC's draws.
        confidence: probability of a good draw at which RANSAC stops earlier.
        seed: of the search; with one thread the same seed gives the same pose.
    """
    o3d = require_package("open3d", "open3d")
    criteria = o3d.pipelines.registration.RANSACConvergenceCriteria(max_iterations, confidence)
    searches: dict[str, Callable[[Described, Described, float], FloatArray]] = {
        "ransac": lambda source, target, size_m: _ransac(o3d, source, target, size_m, criteria),
        "fgr": lambda source, target, size_m: _fgr(o3d, source, target, size_m),
    }
    if search not in searches:
        raise ValueError(f"search={search}: expected one of {', '.join(searches)}")

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        size_m = voxel_size_m or choose_voxel_size(task.source_m, task.target_m)
        source = _describe(o3d, task.source_m, task.source_viewpoint_m, size_m)
        target = _describe(o3d, task.target_m, task.target_viewpoint_m, size_m)
        described = time.perf_counter()
        o3d.utility.random.seed(seed)
        T_coarse = searches[search](source, target, size_m)
        matched = time.perf_counter()
        T_fine = refine_to_planes(o3d, source[0], target[0], T_coarse, size_m)
        return Estimate(
            T_target_source=T_fine,
            T_target_source_coarse=T_coarse,
            stage_s={
                "map": described - started,
                "transform": matched - described,
                "fine": time.perf_counter() - matched,
            },
            reason=f"voxels of {size_m:g} m",
        )

    return run


def refine_to_planes(
    o3d: Any, source: Any, target: Any, T_start: FloatArray, voxel_size_m: float
) -> FloatArray:
    """The (4, 4) pose that point-to-plane ICP reaches; the target has normals."""
    registration = o3d.pipelines.registration
    result = registration.registration_icp(
        source,
        target,
        ICP_DISTANCE_VOXELS * voxel_size_m,
        np.asarray(T_start, dtype=np.float64),
        registration.TransformationEstimationPointToPlane(),
    )
    return np.asarray(result.transformation)


def _describe(
    o3d: Any, points_m: FloatArray, viewpoint_m: FloatArray | None, voxel_size_m: float
) -> Described:
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
    o3d: Any, source: Described, target: Described, voxel_size_m: float, criteria: Any
) -> FloatArray:
    registration = o3d.pipelines.registration
    distance_m = RANSAC_DISTANCE_VOXELS * voxel_size_m
    result = registration.registration_ransac_based_on_feature_matching(
        source[0],
        target[0],
        source[1],
        target[1],
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


def _fgr(o3d: Any, source: Described, target: Described, voxel_size_m: float) -> FloatArray:
    registration = o3d.pipelines.registration
    option = registration.FastGlobalRegistrationOption(
        maximum_correspondence_distance=FGR_DISTANCE_VOXELS * voxel_size_m
    )
    result = registration.registration_fgr_based_on_feature_matching(
        source[0], target[0], source[1], target[1], option
    )
    return np.asarray(result.transformation)
