"""Descriptors of voxels and their correspondences between two scans."""

from __future__ import annotations

import os
from importlib import import_module
from types import ModuleType

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray

FPFH_RADIUS_VOXELS = 5.0
_FPFH_MAX_NEIGHBOURS = 100
_NO_SERVER = "OPEN3D_DISABLE_WEB_VISUALIZER"


def _open3d() -> ModuleType:
    """The library, without the window server that it starts in a notebook, and its words of it."""
    before = os.environ.get(_NO_SERVER)
    os.environ[_NO_SERVER] = "True"
    try:
        return import_module("open3d")
    finally:
        del os.environ[_NO_SERVER]
        if before is not None:
            os.environ[_NO_SERVER] = before


def fpfh(skipmap: SkipMap) -> FloatArray:
    """Fast point feature histograms (Rusu et al., ICRA 2009; Open3D's) on the Skip-map's centroids.

    Args:
        skipmap: normals of one scan must agree in side; without a viewpoint those that look to the
            origin are taken.

    Returns:
        (V, 33) float32, one row per voxel.
    """
    o3d = _open3d()
    if skipmap.viewpoint_m is None:
        skipmap = skipmap.seen_from(np.zeros(3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(skipmap.centroids_m))
    cloud.normals = o3d.utility.Vector3dVector(skipmap.normals)
    neighbourhood = o3d.geometry.KDTreeSearchParamHybrid(
        FPFH_RADIUS_VOXELS * skipmap.voxel_size_m, _FPFH_MAX_NEIGHBOURS
    )
    compute = o3d.pipelines.registration.compute_fpfh_feature
    feature = compute(cloud, neighbourhood)
    return np.asarray(feature.data).T.astype(np.float32)
