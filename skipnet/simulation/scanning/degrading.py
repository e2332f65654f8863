"""What real scenes do between two scans: people walk through and stand in the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.simulation.scanning.scanner import SimulatedScan
from skipnet.types import BoolArray, FloatArray


def add_passers_by(points_m: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Let ``count`` obstacles stop the beams of a scan taken from its origin.

    Each obstacle is a shield that faces the sensor, 3 to 9 degrees in radius, at 30 to 80 % of the
    way to what stood behind it: as seen from the sensor a person, a car, a box left behind.

    Args:
        points_m: (N, 3) scan with the sensor at the origin.
        count: number of obstacles.
        rng: draws where they stand.

    Returns:
        (N, 3) points, those behind an obstacle moved onto it; of the same type.
    """
    moved_m = np.array(points_m)
    range_m = np.linalg.norm(points_m, axis=1)
    direction = points_m / np.maximum(range_m, 1e-9)[:, None]
    for _ in range(count):
        centre = int(rng.integers(len(points_m)))
        shield = direction @ direction[centre] > np.cos(np.deg2rad(rng.uniform(3, 9)))
        distance_m = rng.uniform(0.3, 0.8) * range_m[centre]
        behind = shield & (range_m > distance_m)
        shield_m = distance_m * rng.normal(1, 2e-3, (behind.sum(), 1))
        moved_m[behind] = direction[behind] * shield_m
    return moved_m


def beyond(along_m: FloatArray, share: float) -> BoolArray:
    """(N,) whether a point is not among the ``share`` with the smallest values."""
    return along_m >= np.quantile(along_m, share)


def thin_and_shake(
    points_m: FloatArray, keep: float, noise_m: float, rng: np.random.Generator
) -> FloatArray:
    if keep < 1:
        points_m = points_m[rng.random(len(points_m)) < keep]
    if noise_m > 0:
        points_m = points_m + rng.normal(0, noise_m, points_m.shape)
    return points_m


@dataclass(frozen=True)
class Recipe:
    """How scenes are scanned, spoilt and cut into examples; every share is one of pairs of scans.

    All lengths follow the voxel size, which is drawn too: so nothing here has a scale.
    """

    rings_share: float = 0.25
    """Taken by a spinning scanner of 16 channels."""
    camera_share: float = 0.25
    """Seen by two cameras of a narrow view that look at about the same point."""
    fused_share: float = 0.2
    """Fused from two places each, so that the normals' sides mean nothing."""
    aim_error: float = 0.2
    """How far apart the cameras aim, as a share of their distance from the point."""
    voxel_octaves: float = 1.0
    """The usual voxel size is multiplied by a power of two between minus and plus this."""
    noise_voxels: tuple[float, ...] = (0.0, 0.05, 0.15)
    """Deviations of the points' noise, one of which is drawn."""
    least_kept: float = 0.3
    """Between this share of the points and all of them are kept, in each scan another."""
    holes: int = 6
    """Up to so many balls of points are taken out of each scan, as by things in front of it."""
    curved_share: float = 0.8
    """So many of the examples are drawn by curvature, as keypoints are; the rest evenly."""
    turned_share: float = 0.4
    """Seen from the back of their surfaces: without a viewpoint, any side may be up."""


def fused(scans: Sequence[SimulatedScan]) -> list[FloatArray]:
    """Target and source clouds, each joined with a further scan: they have no one viewpoint."""
    clouds_m = []
    for one, more in zip(scans[:2], scans[2:], strict=True):
        T_one_more = invert(one.T_world_sensor) @ more.T_world_sensor
        clouds_m.append(np.concatenate([one.points_m, transform_points(T_one_more, more.points_m)]))
    return clouds_m


def fields_of_view(
    clouds_m: list[FloatArray],
    T_target_source: FloatArray,
    aim_error: float,
    rng: np.random.Generator,
) -> list[FloatArray]:
    """What two cameras of a narrow view keep that look at about the same point."""
    focus_m = clouds_m[0][rng.integers(len(clouds_m[0]))]
    half_angle_rad = np.deg2rad(rng.uniform(25, 50))
    kept = []
    for cloud_m, T_target_cloud in zip(clouds_m, [np.eye(4), T_target_source], strict=True):
        axis_m = transform_points(invert(T_target_cloud), focus_m[None])[0]
        axis_m = axis_m + rng.normal(0, aim_error, 3) * np.linalg.norm(axis_m)
        cosine = cloud_m @ axis_m / np.linalg.norm(cloud_m, axis=1) / np.linalg.norm(axis_m)
        kept.append(cloud_m[cosine > np.cos(half_angle_rad)])
    return kept


def degrade(
    points_m: FloatArray,
    voxel_size_m: float,
    noise_m: float,
    recipe: Recipe,
    rng: np.random.Generator,
) -> FloatArray:
    """Thin the points out, tear holes and shake what is left."""
    kept = rng.random(len(points_m)) < rng.uniform(recipe.least_kept, 1.0)
    points_m = points_m.take(np.flatnonzero(kept), axis=0)
    x_m, y_m, z_m = np.ascontiguousarray(points_m.T)
    whole = np.ones(len(points_m), dtype=bool)
    for x, y, z in points_m[rng.integers(len(points_m), size=rng.integers(recipe.holes + 1))]:
        radius_m = voxel_size_m * rng.uniform(2, 12)
        whole &= (x_m - x) ** 2 + (y_m - y) ** 2 + (z_m - z) ** 2 > radius_m**2
    left_m = points_m.take(np.flatnonzero(whole), axis=0)
    return left_m + rng.normal(0, noise_m, left_m.shape)
