"""How near fine alignment comes to the bound: ``python -m skipnet.studies.accuracy [pairs]``.

The Cramer-Rao bound of an alignment of surfaces patch by patch: each patch of a plane surface that
both scans see tells the distance along its normal, with the variance that range noise leaves after
averaging over its points in either scan. (A method that knew the planes to be planes could do
better still: it could compare parts that only one scan sees.) GICP starts from the truth, skipnet
from nothing.
"""

from __future__ import annotations

import sys

import numpy as np

from skipnet.geometry import transform_points
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import SimulatedPair, simulate_pair
from skipnet.simulation.scanning.scanner import find_scanner
from skipnet.simulation.seeds import ACCURACY
from skipnet.types import FloatArray, IntArray

FAMILIES = ("paper_room", "oblique", "doorway")
PATCH_M = 0.2
GICP_VOXEL_M = 0.05
MIN_COSINE = 0.02
"""Of incidence: a grazing beam's noise hardly moves the surface, but edges do."""
MAX_THICKNESS_M = 1e-4
"""Scatter of a plane surface's noise-free points."""


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
    cells = np.floor(points_m / PATCH_M).astype(np.int32)
    _, patch = np.unique(np.column_stack([surface, cells]), axis=0, return_inverse=True)
    patch = patch.ravel()
    split = len(clouds_m[0])
    precision = []
    for part, sensor_m in zip((slice(0, split), slice(split, None)), sensors_m, strict=True):
        ways_m = points_m[part] - sensor_m
        cosine = np.abs(np.einsum("ij,ij->i", ways_m, normals[part]))
        cosine /= np.linalg.norm(ways_m, axis=1)
        each = 1 / (sigma_m * np.maximum(cosine, MIN_COSINE)) ** 2
        precision.append(np.bincount(patch[part], each, minlength=patch.max() + 1))
    both = (precision[0] > 0) & (precision[1] > 0)
    weight = 1 / (1 / precision[0][both] + 1 / precision[1][both])
    first = np.unique(patch, return_index=True)[1][both]
    normal, at_m = normals[first], points_m[first]
    jacobian = np.hstack([np.cross(at_m - sensors_m[0], normal), normal])
    information = (jacobian * weight[:, None]).T @ jacobian
    return float(np.sqrt(np.trace(np.linalg.inv(information)[3:, 3:])))


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


def main(pairs: int = 20) -> None:
    """Print, per family, the errors of both methods as multiples of the bound."""
    from small_gicp import align

    for family in FAMILIES:
        ours_m: list[float] = []
        gicp_m: list[float] = []
        least_m: list[float] = []
        for seed in ACCURACY.take(pairs):
            pair = simulate_pair(family, seed, rotation="any")
            truth, clouds = pair.T_target_source, pair.pair
            result = register(clouds.source_m, clouds.target_m)
            peer = align(
                clouds.target_m.astype(np.float64),
                clouds.source_m.astype(np.float64),
                truth,
                downsampling_resolution=GICP_VOXEL_M,
                max_correspondence_distance=4 * GICP_VOXEL_M,
            )
            for errors_m, T in ((ours_m, result.T_target_source), (gicp_m, peer.T_target_source)):
                errors_m.append(float(np.linalg.norm((T - truth)[:3, 3])))
            least_m.append(bound_m(pair, find_scanner("terrestrial").range_sigma_m))
        ours, gicp, least = (1000 * np.array(e) for e in (ours_m, gicp_m, least_m))
        print(
            f"{family}: bound {np.median(least):.3f} mm, skipnet {np.median(ours):.3f} mm "
            f"({np.median(ours / least):.1f} x), GICP from the truth {np.median(gicp):.3f} mm "
            f"({np.median(gicp / least):.1f} x), medians of {pairs} pairs"
        )


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:2]))
