"""How a scan gets worse than a still room before one scanner gives it: the one place for it.

People pass by, points are noisy or missing, cameras see little, clouds are fused from several
places. Benchmarks, studies and training data are made worse by these same steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.simulation.scanning.recipe import Recipe
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


def cut(points_m: FloatArray, along_m: FloatArray, share: float) -> FloatArray:
    """Leave out the ``share`` of the (N, 3) points whose (N,) ``along_m`` is smallest."""
    return points_m[along_m >= np.quantile(along_m, share)]


def thin(points_m: FloatArray, least: float, most: float, rng: np.random.Generator) -> FloatArray:
    """Keep a share of the points, itself drawn between ``least`` and ``most``."""
    chances = rng.random(len(points_m))
    return points_m.take(np.flatnonzero(chances < rng.uniform(least, most)), axis=0)


def shake(points_m: FloatArray, noise_m: float, rng: np.random.Generator) -> FloatArray:
    """Add noise of this deviation to every coordinate."""
    return points_m + rng.normal(0, noise_m, points_m.shape)


def blur_depth(points_m: FloatArray, noise_per_m: float, rng: np.random.Generator) -> FloatArray:
    """A depth camera's noise along the beams: its deviation grows with the range's square.

    Args:
        points_m: (N, 3), the sensor at the origin.
        noise_per_m: deviation of the range, in metres, at a range of 1 m.
        rng: draws the noise.

    Returns:
        (N, 3) of the same type.
    """
    range_m = np.linalg.norm(points_m, axis=1)
    share = 1 + rng.normal(0, noise_per_m * range_m)
    return (points_m * share[:, None]).astype(points_m.dtype)


def tear_holes(
    points_m: FloatArray, count: int, voxel_size_m: float, rng: np.random.Generator
) -> FloatArray:
    """Take out balls of 2 to 12 voxels about so many of the points, as things in front would."""
    x_m, y_m, z_m = np.ascontiguousarray(points_m.T)
    whole = np.ones(len(points_m), dtype=bool)
    for x, y, z in points_m[rng.integers(len(points_m), size=count)]:
        radius_m = voxel_size_m * rng.uniform(2, 12)
        whole &= (x_m - x) ** 2 + (y_m - y) ** 2 + (z_m - z) ** 2 > radius_m**2
    return points_m.take(np.flatnonzero(whole), axis=0)


def in_cone(points_m: FloatArray, axis: FloatArray, half_angle_rad: float) -> BoolArray:
    """(N,) which (N, 3) points lie within an angle of a (3,) direction, seen from the origin."""
    cosine = points_m @ axis / np.linalg.norm(points_m, axis=1) / np.linalg.norm(axis)
    inside: BoolArray = cosine > np.cos(half_angle_rad)
    return inside


def fuse(clouds_m: Sequence[FloatArray], T_world_cloud: Sequence[FloatArray]) -> FloatArray:
    """All clouds joined in the frame of the first: they have no one viewpoint.

    Args:
        clouds_m: (N, 3) each, in its own frame.
        T_world_cloud: (4, 4) each.
    """
    T_first_world = invert(T_world_cloud[0])
    others_m = [
        transform_points(T_first_world @ T_world_one, one_m)
        for T_world_one, one_m in zip(T_world_cloud[1:], clouds_m[1:], strict=True)
    ]
    return np.concatenate([clouds_m[0], *others_m])


def fused(scans: Sequence[SimulatedScan]) -> list[FloatArray]:
    """Target and source clouds, each joined with a further scan: they have no one viewpoint."""
    return [
        fuse([one.points_m, more.points_m], [one.T_world_sensor, more.T_world_sensor])
        for one, more in zip(scans[:2], scans[2:], strict=True)
    ]


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
        kept.append(cloud_m[in_cone(cloud_m, axis_m, half_angle_rad)])
    return kept


def degrade(
    points_m: FloatArray,
    voxel_size_m: float,
    noise_m: float,
    recipe: Recipe,
    rng: np.random.Generator,
) -> FloatArray:
    """Thin the points out, tear holes and shake what is left."""
    points_m = thin(points_m, recipe.least_kept, 1.0, rng)
    points_m = tear_holes(points_m, int(rng.integers(recipe.holes + 1)), voxel_size_m, rng)
    return shake(points_m, noise_m, rng)
