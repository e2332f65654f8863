"""Narrow views of a scene, one or several near ones fused: depth cameras and narrow LiDARs.

What a hand-held depth camera makes is a fragment: some near views of about the same thing, joined
as well as tracking allows. A narrow LiDAR looks one way and far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, make_transform, rotation_from_vector, transform_points
from skipnet.simulation.scenes.scenes import Scene, is_free, make_scene, place_sensors
from skipnet.types import FloatArray

_NEAREST_M = 0.3


@dataclass(frozen=True)
class Eye:
    """What looks, and how it is moved."""

    rays: int
    """Of one view."""
    half_angle_rad: tuple[float, float]
    """Range of half the width of the view, which is 4 : 3."""
    views: tuple[int, int] = (1, 1)
    """Least and most views that are fused into a cloud."""
    wander_m: float = 0.0
    """Deviation of the step from one view to the next."""
    noise_m: float = 0.0
    """Deviation of a range, whatever it is, ..."""
    noise_per_m: float = 0.0
    """... and at a range of 1 m; this part grows with the range's square."""
    drift_m: float = 0.0
    """Deviation of a view's place from where the fusion puts it, and, at 1 m, of its direction."""
    max_range_m: float = 6.0
    aside_m: float = 1.0
    """Every other source stands beside the target, about so far; the rest elsewhere."""
    rise_rad: tuple[float, float] = (np.deg2rad(-35.0), np.deg2rad(5.0))
    """Elevations of the way ahead."""


EYES: dict[str, Eye] = {
    "camera": Eye(60_000, (0.42, 0.58), noise_per_m=0.0015),
    "fragment": Eye(
        *(22_000, (0.42, 0.58), (3, 7)),
        wander_m=0.2,
        noise_per_m=0.0015,
        drift_m=0.006,
    ),
    "narrow_lidar": Eye(
        *(60_000, (0.3, 0.7)),
        noise_m=0.02,
        max_range_m=80.0,
        aside_m=4.0,
    ),
    "level_lidar": Eye(
        *(60_000, (0.5, 0.75)),
        noise_m=0.02,
        max_range_m=80.0,
        aside_m=4.0,
        rise_rad=(np.deg2rad(-12.0), np.deg2rad(10.0)),
    ),
}


def glimpse(
    family: str, seed: int, eye: Eye, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Look at scene ``seed`` of a family twice; the farther apart the views, the less they share.

    Args:
        family: one of ``skipnet.simulation.scenes.scenes.FAMILIES``.
        seed: of the scene and the two places.
        eye: what looks.
        rng: draws the rest.

    Returns:
        (N, 3) source and (M, 3) target, each in the frame of its first view, the origin there, and
        the true (4, 4) ``T_target_source``.
    """
    scene = make_scene(family, seed)
    first, second = place_sensors(scene, 2, seed)[:, :3, 3]
    if rng.random() < 0.5:
        beside = first + rng.normal(0, eye.aside_m, 3) * [1, 1, 0.2]
        second = beside if is_free(scene, beside[None])[0] else second
    half_angle_rad = rng.uniform(*eye.half_angle_rad)
    yaw_rad, rise_rad = rng.uniform(0, 2 * np.pi), rng.uniform(*eye.rise_rad)
    # The way that the source looks is turned from the target's, as seen from the target.
    turn_rad = rng.uniform(0, 2.0) * half_angle_rad * rng.choice([-1, 1])
    clouds, poses = [], []
    for place_m, way_rad in ((second, yaw_rad + turn_rad), (first, yaw_rad)):
        focus_m = _focus(scene, first, way_rad, rise_rad, eye.max_range_m)
        cloud_m, T_world_cloud = _look(scene, place_m, focus_m, half_angle_rad, eye, rng)
        clouds.append(cloud_m)
        poses.append(T_world_cloud)
    return clouds[0], clouds[1], invert(poses[1]) @ poses[0]


def _focus(
    scene: Scene, from_m: FloatArray, yaw_rad: float, rise_rad: float, max_range_m: float
) -> FloatArray:
    """(3,) the point that lies in a direction; a far one where nothing does."""
    flat = np.cos(rise_rad)
    way = np.array([flat * np.cos(yaw_rad), flat * np.sin(yaw_rad), np.sin(rise_rad)])
    distance_m = scene.raycaster.cast(from_m, way[None]).distances[0]
    focus_m: FloatArray = from_m + min(distance_m, max_range_m) * way
    return focus_m


def _look(
    scene: Scene,
    place_m: FloatArray,
    focus_m: FloatArray,
    half_angle_rad: float,
    eye: Eye,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) points of all views in the frame of the first, and that frame in the world."""
    T_world_first = _towards(place_m, focus_m)
    parts, T_world_view = [], T_world_first
    distance_m = float(np.linalg.norm(focus_m - place_m))
    for _ in range(rng.integers(eye.views[0], eye.views[1] + 1)):
        points_m = _view(scene, T_world_view, half_angle_rad, eye, rng)
        drift = rotation_from_vector(rng.normal(0, eye.drift_m, 3))
        fused = make_transform(drift, rng.normal(0, eye.drift_m, 3))
        parts.append(transform_points(fused @ invert(T_world_first) @ T_world_view, points_m))
        place_m = place_m + rng.normal(0, eye.wander_m, 3)
        aimed_m = focus_m + rng.normal(0, 0.15 * distance_m, 3)
        T_world_view = _towards(place_m, aimed_m)
    return np.concatenate(parts), T_world_first


def _towards(place_m: FloatArray, focus_m: FloatArray) -> FloatArray:
    """(4, 4) ``T_world_view`` of a view that looks along its z at a point."""
    ahead = (focus_m - place_m) / max(float(np.linalg.norm(focus_m - place_m)), 1e-9)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return make_transform(np.stack([right, np.cross(ahead, right), ahead], axis=1), place_m)


def _view(
    scene: Scene,
    T_world_view: FloatArray,
    half_angle_rad: float,
    eye: Eye,
    rng: np.random.Generator,
) -> FloatArray:
    """(N, 3) points of one view in its own frame."""
    half = np.tan(half_angle_rad) * np.array([1.0, 0.75])
    across = rng.uniform(-1, 1, (eye.rays, 2)) * half
    ways = np.concatenate([across, np.ones((eye.rays, 1))], axis=1)
    lengths = np.linalg.norm(ways, axis=1)
    hits = scene.raycaster.cast(T_world_view[:3, 3], ways @ T_world_view[:3, :3].T)
    range_m = hits.distances * lengths
    seen = (range_m > _NEAREST_M) & (range_m < eye.max_range_m)
    sigma_m = np.hypot(eye.noise_m, eye.noise_per_m * range_m[seen] ** 2)
    noisy_m = range_m[seen] + rng.normal(0, 1, seen.sum()) * sigma_m
    points_m: FloatArray = ways[seen] * (noisy_m / lengths[seen])[:, None]
    return points_m
