"""How near fine alignment comes to the bound: ``skipnet study accuracy``.

The Cramer-Rao bound of an alignment of surfaces patch by patch: each patch of a plane surface that
both scans see tells the distance along its normal, with the variance that range noise leaves after
averaging over its points in either scan. (A method that knew the planes to be planes could do
better still: it could compare parts that only one scan sees.) GICP starts from the truth, skipnet
from nothing. Then, on more kinds of scans: does the truth lie where the stated covariance says?
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from skipnet.geometry import transform_points
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import SimulatedPair, simulate_pair
from skipnet.simulation.scanning.scanner import find_scanner
from skipnet.simulation.seeds import ACCURACY
from skipnet.studies.coverage import STATED, coverage_table, try_stated
from skipnet.studies.options import AccuracyConfig
from skipnet.studies.study import do_all, report
from skipnet.types import FloatArray, IntArray
from skipnet.viz.tables import Table

FAMILIES = ("paper_room", "oblique", "doorway")
SCANNER = "terrestrial"
PATCH_M = 0.2
GICP_VOXEL_M = 0.05
MIN_COSINE = 0.02
"""Of incidence: a grazing beam's noise hardly moves the surface, but edges do."""
MAX_THICKNESS_M = 1e-4
"""Scatter of a plane surface's noise-free points."""

Errors = dict[str, FloatArray]
"""Millimetres of every pair: "bound", "skipnet" and "gicp"."""


def run(config: AccuracyConfig) -> dict[str, Any]:
    """Measure both methods on every family and report; the summary comes back."""
    seeds = ACCURACY.take(config.pairs, config.seed)
    jobs = {f"{family}/{seed}": (family, seed) for family in FAMILIES for seed in seeds}
    found = do_all(jobs, try_pair, Path(config.output_dir), config.workers)
    errors_mm: dict[str, Errors] = {}
    for family in FAMILIES:
        of = [one for one, job in zip(found, jobs.values(), strict=True) if job[0] == family]
        errors_mm[family] = {name: np.array([one[name] for one in of]) for name in of[0]}
    stated = {f"stated, {name}/{seed}": (name, seed) for name in STATED for seed in seeds}
    outcomes = do_all(stated, try_stated, Path(config.output_dir), config.workers)
    each = len(seeds)
    of_kind = {name: outcomes[k * each : (k + 1) * each] for k, name in enumerate(STATED)}
    return report(
        config,
        "Accuracy: how near does fine alignment come to the bound?",
        {
            "scans": f"{config.pairs} pairs of each family, scanner {SCANNER}, any rotation",
            "scenes": f"from number {config.seed} of {ACCURACY.first}",
        },
        [errors_table(errors_mm), coverage_table(of_kind)],
        medians_mm={f: {n: np.median(e) for n, e in of.items()} for f, of in errors_mm.items()},
    )


def try_pair(job: tuple[str, int]) -> dict[str, float]:
    """Millimetres that the source's origin is off, of both methods, and their bound."""
    from small_gicp import align

    family, seed = job
    pair = simulate_pair(family, seed, scanner=SCANNER, rotation="any")
    truth, clouds = pair.T_target_source, pair.pair
    peer = align(
        clouds.target_m.astype(np.float64),
        clouds.source_m.astype(np.float64),
        truth,
        downsampling_resolution=GICP_VOXEL_M,
        max_correspondence_distance=4 * GICP_VOXEL_M,
    )
    ours = register(clouds.source_m, clouds.target_m)
    off_m: dict[str, Any] = {
        "bound": bound_m(pair, find_scanner(SCANNER).range_sigma_m),
        "skipnet": np.linalg.norm((ours.T_target_source - truth)[:3, 3]),
        "gicp": np.linalg.norm((peer.T_target_source - truth)[:3, 3]),
    }
    return {name: 1000 * float(one_m) for name, one_m in off_m.items()}


def errors_table(errors_mm: dict[str, Errors]) -> Table:
    """Per family the bound, and both methods in millimetres and as multiples of it."""
    rows = []
    for family, of in errors_mm.items():
        cells = [f"{np.median(of['bound']):.3f} mm"]
        for name in ("skipnet", "gicp"):
            times = np.median(of[name] / of["bound"])
            cells.append(f"{np.median(of[name]):.3f} mm ({times:.1f} x)")
        rows.append((family, *cells))
    note = f"Medians; the bound is what patches of {PATCH_M:g} m that both scans see leave open."
    headers = ("", "bound", "skipnet", "GICP from the truth")
    return Table("Error of the source's origin", headers, tuple(rows), note)


def bound_m(pair: SimulatedPair, sigma_m: float) -> float:
    """Least root mean square error of the source's origin that any unbiased method can have.

    Args:
        pair: two scans of one scene of plane surfaces, with their noise-free points.
        sigma_m: standard deviation of the range.
    """
    sensors_m = (pair.T_target_source[:3, 3], np.zeros(3))
    clouds_m = [
        transform_points(T, scan.true_points_m.astype(np.float64))
        for T, scan in ((pair.T_target_source, pair.source), (np.eye(4), pair.target))
    ]
    points_m = np.concatenate(clouds_m)
    surface = np.concatenate([pair.source.surface_of_point, pair.target.surface_of_point])
    normals = _normals(points_m, surface)[surface]
    patch = _patches(points_m, surface)
    split, count = len(clouds_m[0]), patch.max() + 1
    # What either scan knows of each patch's distance along the normal: 1 / variance.
    precision = [
        np.bincount(patch[part], _weights(points_m[part] - at_m, normals[part], sigma_m), count)
        for part, at_m in zip((slice(0, split), slice(split, None)), sensors_m, strict=True)
    ]
    both = (precision[0] > 0) & (precision[1] > 0)
    weight = 1 / (1 / precision[0][both] + 1 / precision[1][both])
    first = np.unique(patch, return_index=True)[1][both]
    # A small motion of the source about its sensor moves a patch along its normal by this much.
    jacobian = np.hstack([np.cross(points_m[first] - sensors_m[0], normals[first]), normals[first]])
    information = (jacobian * weight[:, None]).T @ jacobian
    return float(np.sqrt(np.trace(np.linalg.inv(information)[3:, 3:])))


def _patches(points_m: FloatArray, surface: IntArray) -> IntArray:
    """(N,) number of each point's patch: a cell of one surface."""
    cells = np.floor(points_m / PATCH_M).astype(np.int32)
    _, patch = np.unique(np.column_stack([surface, cells]), axis=0, return_inverse=True)
    numbers: IntArray = patch.ravel()
    return numbers


def _weights(ways_m: FloatArray, normals: FloatArray, sigma_m: float) -> FloatArray:
    """(N,) 1 / variance of each point across its surface, seen along (N, 3) ways."""
    cosine = np.abs(np.einsum("ij,ij->i", ways_m, normals)) / np.linalg.norm(ways_m, axis=1)
    weights: FloatArray = 1 / (sigma_m * np.maximum(cosine, MIN_COSINE)) ** 2
    return weights


def _normals(points_m: FloatArray, surface: IntArray) -> FloatArray:
    """(S, 3) normals of plane surfaces, from their noise-free points; 0 for one that is curved."""
    count = np.bincount(surface)
    total_m = np.stack([np.bincount(surface, x) for x in points_m.T], axis=1)
    mean = total_m / np.maximum(count, 1)[:, None]
    x, y, z = (points_m - mean[surface]).T
    second = np.stack([np.bincount(surface, a * b) for a in (x, y, z) for b in (x, y, z)], axis=1)
    values, vectors = np.linalg.eigh(second.reshape(-1, 3, 3) / np.maximum(count, 1)[:, None, None])
    plane = (values[:, 0] < MAX_THICKNESS_M**2) & (count > 3)
    return vectors[:, :, 0] * plane[:, None]
