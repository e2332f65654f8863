"""Descriptors of voxels and their correspondences between two scans."""

from __future__ import annotations

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

FPFH_RADIUS_VOXELS = 5.0
_FPFH_MAX_NEIGHBOURS = 100


def fpfh(skipmap: SkipMap) -> FloatArray:
    """Fast point feature histograms (Rusu et al., ICRA 2009; Open3D's) on the Skip-map's centroids.

    Args:
        skipmap: normals of one scan must agree in side; without a viewpoint those of the origin are taken.

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
    feature = o3d.pipelines.registration.compute_fpfh_feature(cloud, neighbourhood)
    return np.asarray(feature.data).T.astype(np.float32)


def mutual_nearest(source: FloatArray, target: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of descriptors that are each other's nearest.

    Args:
        source: (V, D) descriptors.
        target: (W, D) descriptors.

    Returns:
        (K,) rows of the source, (K,) rows of the target, and (K,) distances between the descriptors.
    """
    forward, distance = _nearest(source, target)
    backward, _ = _nearest(target, source)
    rows = np.flatnonzero(backward[forward] == np.arange(len(source)))
    return rows, forward[rows], distance[rows]


def _nearest(query: FloatArray, base: FloatArray, chunk: int = 2048) -> tuple[IntArray, FloatArray]:
    """Row of the nearest base descriptor for each query, and its distance, by blocks of a matrix product."""
    base_squared = np.einsum("ij,ij->i", base, base)
    rows, distances = [], []
    for start in range(0, len(query), chunk):
        block = query[start : start + chunk]
        score = base_squared - 2 * (block @ base.T)
        best = score.argmin(axis=1)
        rows.append(best)
        squared = score[np.arange(len(block)), best] + np.einsum("ij,ij->i", block, block)
        distances.append(np.sqrt(np.maximum(squared, 0)))
    return np.concatenate(rows), np.concatenate(distances)
