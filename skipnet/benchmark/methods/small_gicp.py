"""GICP of small_gicp from a given start: a local method, and the fine stage of KISS-Matcher."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.checks import require_package
from skipnet.types import FloatArray

REACH_VOXELS = 4.0
"""Correspondences farther apart than this are dropped; 1 m at the package's own 0.25 m voxels."""


def make(voxel_size_m: float = 0.25, threads: int = 1) -> Method:
    """Generalised ICP (Segal 2009) on voxels from ``T_target_source_start``.

    Args:
        voxel_size_m: size of the voxels that thin the clouds.
        threads: threads it may use.
    """
    small_gicp = require_package("small_gicp", "small_gicp")

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        T_fine = refine(small_gicp, task, task.T_target_source_start, voxel_size_m, threads)
        return Estimate(T_target_source=T_fine, stage_s={"fine": time.perf_counter() - started})

    return run


def refine(
    small_gicp: Any, task: Task, T_start: FloatArray, voxel_size_m: float, threads: int
) -> FloatArray:
    """The (4, 4) pose that GICP reaches from ``T_start``; its ``converged`` proves nothing."""
    result = small_gicp.align(
        np.asarray(task.target_m, dtype=np.float64),
        np.asarray(task.source_m, dtype=np.float64),
        init_T_target_source=np.asarray(T_start, dtype=np.float64),
        registration_type="GICP",
        downsampling_resolution=voxel_size_m,
        max_correspondence_distance=REACH_VOXELS * voxel_size_m,
        num_threads=threads,
    )
    return np.asarray(result.T_target_source)
