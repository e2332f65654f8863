"""What of a simulated scene a scanner can see, and how densely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, transform_points
from skipnet.simulation.scanning.scanner import Scanner
from skipnet.simulation.scenes.scenes import Scene
from skipnet.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class VisibleSurface:
    """Samples of all that a sensor can see of a scene, in the sensor's frame."""

    points_m: FloatArray
    """(S, 3) positions."""
    normals: FloatArray
    """(S, 3) unit normals, on the sensor's side."""
    surfaces: IntArray
    """(S,) id of the surface each sample belongs to."""
    areas_m2: FloatArray
    """(S,) area each sample stands for."""
    beams: FloatArray
    """(S,) beams of the scanner that meet that area, on average."""


def sample_scene(
    scene: Scene, spacing_m: float
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Cover every triangle evenly with samples, about one per ``spacing_m`` squared.

    Each triangle gets its own stretch of the R2 low-discrepancy sequence (Roberts 2018), so that
    the area seen through a small ball is met far better than by random points.

    Returns:
        (S, 3) points and (S, 3) unit normals in the world frame, (S,) triangle rows, (S,) areas.
    """
    a, b, c = (scene.vertices_m[scene.triangles[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    area_m2 = np.linalg.norm(normal, axis=1) / 2
    count = np.ceil(area_m2 / spacing_m**2).astype(np.int64)
    triangle = np.repeat(np.arange(len(count)), count)
    rank = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    plastic = 1.32471795724474602596
    u, v = (np.mod(0.5 + rank / plastic, 1.0), np.mod(0.5 + rank / plastic**2, 1.0))
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    points_m = a[triangle] + u[:, None] * (b - a)[triangle] + v[:, None] * (c - a)[triangle]
    unit = normal / np.maximum(2 * area_m2, 1e-30)[:, None]
    return points_m, unit[triangle], triangle, (area_m2 / np.maximum(count, 1))[triangle]


def visible_surface(
    scene: Scene, scanner: Scanner, T_world_sensor: FloatArray, spacing_m: float
) -> VisibleSurface:
    """All that a scanner at ``T_world_sensor`` can see of ``scene``.

    Args:
        scene: what stands there.
        scanner: its field of view, range and beam density.
        T_world_sensor: (4, 4) its pose.
        spacing_m: distance between samples; a third of a voxel is fine enough.
    """
    points_m, normals, triangle, areas_m2 = sample_scene(scene, spacing_m)
    ray_m = points_m - T_world_sensor[:3, 3]
    range_m = np.linalg.norm(ray_m, axis=1)
    facing = -np.einsum("si,si->s", normals, ray_m) / range_m
    direction = (ray_m / range_m[:, None]) @ T_world_sensor[:3, :3]
    beams = areas_m2 * np.abs(facing) / range_m**2 * beam_density(scanner, direction)
    seen = (beams > 0) & (range_m >= scanner.min_range_m) & (range_m <= scanner.max_range_m)
    seen[seen] = _unoccluded(scene, T_world_sensor[:3, 3], points_m[seen])
    T_sensor_world = invert(T_world_sensor)
    towards = normals[seen] * np.sign(facing[seen])[:, None]
    return VisibleSurface(
        transform_points(T_sensor_world, points_m[seen]),
        towards @ T_sensor_world[:3, :3].T,
        scene.surface_of_triangle[triangle[seen]].astype(np.int64),
        areas_m2[seen],
        beams[seen],
    )


def beam_density(scanner: Scanner, directions: FloatArray) -> FloatArray:
    """Beams per steradian of a scanner's regular grid of elevations and azimuths.

    Args:
        scanner: the model.
        directions: (S, 3) unit vectors in the frame in which the scanner sweeps about z.

    Returns:
        (S,) density, 0 outside the field of view. The grid crowds towards the poles.
    """
    elevation_rad = np.arcsin(np.clip(directions[:, 2], -1, 1))
    span_rad = scanner.highest_rad - scanner.lowest_rad
    per_rad2 = scanner.channels / span_rad * scanner.azimuth_steps / (2 * np.pi)
    inside = (elevation_rad >= scanner.lowest_rad) & (elevation_rad <= scanner.highest_rad)
    return np.where(inside, per_rad2 / np.maximum(np.cos(elevation_rad), 1e-2), 0.0)


def _unoccluded(scene: Scene, sensor_m: FloatArray, points_m: FloatArray) -> BoolArray:
    """(S,) bool: nothing stands between the sensor and the point."""
    hits = scene.raycaster.cast(sensor_m, points_m - sensor_m)
    # The ray's unit is the way to the point: 1 is the point itself, met up to rounding.
    return hits.distances >= 1 - 1e-3
