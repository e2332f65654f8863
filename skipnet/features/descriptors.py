"""Descriptors of voxels and their correspondences between two scans."""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

FPFH_RADIUS_VOXELS = 5.0
_FPFH_MAX_NEIGHBOURS = 100
_BLOCK = 512
"""Rows compared at a time: their distances to all others stay in the processor's cache."""


def fpfh(skipmap: SkipMap) -> FloatArray:
    """Fast point feature histograms (Rusu et al., ICRA 2009; Open3D's) on the Skip-map's centroids.

    Args:
        skipmap: normals of one scan must agree in side; without a viewpoint those that look to the
            origin are taken.

    Returns:
        (V, 33) float32, one row per voxel.
    """
    import open3d as o3d

    if skipmap.viewpoint_m is None:
        skipmap = skipmap.seen_from(np.zeros(3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(skipmap.centroids_m))
    cloud.normals = o3d.utility.Vector3dVector(skipmap.normals)
    neighbourhood = o3d.geometry.KDTreeSearchParamHybrid(
        FPFH_RADIUS_VOXELS * skipmap.voxel_size_m, _FPFH_MAX_NEIGHBOURS
    )
    compute = o3d.pipelines.registration.compute_fpfh_feature
    feature = compute(cloud, neighbourhood)  # type: ignore[call-arg]  # indices are optional
    return np.asarray(feature.data).T.astype(np.float32)


def mutual_nearest(source: FloatArray, target: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of descriptors that are each other's nearest.

    Args:
        source: (V, D) descriptors.
        target: (W, D) descriptors.

    Returns:
        (K,) rows of the source, (K,) rows of the target, and (K,) their descriptors' distances.
    """
    if len(source) == 0 or len(target) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.float32)
    forward = np.empty(len(source), dtype=np.int64)
    backward = np.zeros(len(target), dtype=np.int64)
    nearest_squared = np.full(len(target), np.inf, dtype=np.float32)
    squared_s, squared_t = ((rows**2).sum(axis=1) for rows in (source, target))
    for start in range(0, len(source), _BLOCK):
        block = slice(start, start + _BLOCK)
        squared = squared_s[block, None] + squared_t - 2 * (source[block] @ target.T)
        forward[block] = squared.argmin(axis=1)
        best = squared.argmin(axis=0)
        best_squared = squared[best, np.arange(len(target))]
        nearer = best_squared < nearest_squared
        backward[nearer] = start + best[nearer]
        nearest_squared[nearer] = best_squared[nearer]
    rows = np.flatnonzero(backward[forward] == np.arange(len(source)))
    distance = np.sqrt(np.maximum(nearest_squared[forward[rows]], 0))
    return rows, forward[rows], distance
