"""KISS-Matcher (Lim et al. 2025), alone or with small_gicp's GICP for the fine pose."""

from __future__ import annotations

import time

import numpy as np

from skipnet.benchmark.methods import Estimate, Method, Task
from skipnet.benchmark.methods.small_gicp import refine
from skipnet.checks import require_package
from skipnet.geometry import make_transform

SMALLEST_VOXEL_M = 0.005
"""The package refuses smaller ones."""


def make(
    voxel_size_m: float = 0.3, fine: bool = True, fine_voxel_size_m: float | None = None
) -> Method:
    """KISS-Matcher with its default gains, then GICP.

    Args:
        voxel_size_m: the matcher's voxel size, the one figure it needs; the package's own default.
        fine: whether GICP follows.
        fine_voxel_size_m: voxel size of GICP; None takes half of ``voxel_size_m``.
    """
    if voxel_size_m < SMALLEST_VOXEL_M:
        raise ValueError(
            f"voxel_size_m={voxel_size_m}: KISS-Matcher needs at least {SMALLEST_VOXEL_M} m"
        )
    kiss_matcher = require_package("kiss_matcher", "kiss-matcher")
    small_gicp = require_package("small_gicp", "small_gicp") if fine else None
    fine_m = voxel_size_m / 2 if fine_voxel_size_m is None else fine_voxel_size_m

    def run(task: Task) -> Estimate:
        """Answer one task."""
        started = time.perf_counter()
        matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size_m))
        solution = matcher.estimate(
            np.asarray(task.source_m, dtype=np.float32), np.asarray(task.target_m, dtype=np.float32)
        )
        matched = time.perf_counter()
        T_coarse = make_transform(np.asarray(solution.rotation), np.ravel(solution.translation))
        prepared_s = matcher.get_processing_time() + matcher.get_extraction_time()
        stage_s = {"map": prepared_s, "transform": matched - started - prepared_s}
        reason = f"{matcher.get_num_final_inliers()} final inliers"
        if small_gicp is None:
            return Estimate(T_coarse, stage_s, reason=reason)
        T_fine = refine(small_gicp, task, T_coarse, fine_m, threads=1)
        stage_s["fine"] = time.perf_counter() - matched
        return Estimate(T_fine, stage_s, T_coarse, reason=reason)

    return run
