"""What situations are made of: solids put anywhere, sensors of any pattern, sampled models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skipnet.geometry import (
    invert,
    make_transform,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.simulation.scenes import shapes
from skipnet.simulation.scenes.raycasting import Raycaster
from skipnet.simulation.scenes.shapes import Surface, join, moved, shifted
from skipnet.types import FloatArray

Solids = list[Surface]
Place = Sequence[float] | FloatArray
BALL_SEGMENTS = 32
_FIRST_EDGE, _SECOND_EDGE = 1, 2


@dataclass(frozen=True)
class Situation:
    """Two clouds, and what an honest tool may say of them."""

    name: str
    source_m: FloatArray
    """(N, 3) in its own frame."""
    target_m: FloatArray
    """(M, 3) likewise."""
    T_target_source: FloatArray | None
    """(4, 4) the truth; None where no rigid motion brings one onto the other."""


def upright(yaw_rad: float, place_m: Place) -> FloatArray:
    """(4, 4) pose of what stands at a place, turned about the vertical."""
    turn = rotation_from_vector(np.array([0.0, 0.0, yaw_rad]))
    return make_transform(turn, np.asarray(place_m, dtype=np.float64))


def block(size_m: Place, centre_m: Place, yaw_rad: float = 0.0) -> Solids:
    """A box about its centre."""
    sides_m = np.asarray(size_m, dtype=np.float64)
    middle = shifted(shapes.box(sides_m), (0.0, 0.0, -sides_m[2] / 2))
    return moved(middle, upright(yaw_rad, centre_m))


def drum(radius_m: float, height_m: float, centre_m: Place) -> Solids:
    """An upright cylinder about its centre."""
    x_m, y_m, z_m = centre_m
    return shifted(shapes.cylinder(radius_m, height_m), (x_m, y_m, z_m - height_m / 2))


def ball(radius_m: float, centre_m: Place) -> Solids:
    """A ball about its centre."""
    x_m, y_m, z_m = centre_m
    return shifted(shapes.sphere(radius_m, BALL_SEGMENTS), (x_m, y_m, z_m - radius_m))


def scaled(solids: Solids, factor: float) -> Solids:
    """The same, larger or smaller about the origin."""
    return [replace(one, vertices_m=factor * one.vertices_m) for one in solids]


def caster_of(solids: Solids) -> Raycaster:
    """Answers rays against solids."""
    whole = join(solids)
    return Raycaster(whole.vertices_m, whole.triangles)


def rings(columns: int, lines: int, lowest_deg: float, highest_deg: float) -> FloatArray:
    """(columns * lines, 3) directions of a sensor that spins about its vertical axis."""
    azimuth_rad = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    elevation_rad = np.deg2rad(np.linspace(lowest_deg, highest_deg, lines))
    a, e = np.meshgrid(azimuth_rad, elevation_rad)
    ways = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return ways.reshape(-1, 3)


def camera(
    eye_m: FloatArray, at_m: Place, opening_deg: float, columns: int, lines: int
) -> tuple[FloatArray, FloatArray]:
    """(4, 4) pose of a camera at (3,) ``eye_m`` that looks at a place, z ahead and y down, and the
    (columns * lines, 3) directions of its pixels in its own frame."""
    ahead = np.asarray(at_m, dtype=np.float64) - eye_m
    ahead /= np.linalg.norm(ahead)
    up = np.eye(3)[2 if abs(ahead[2]) < 0.97 else 1]
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    half = np.tan(np.deg2rad(opening_deg / 2))
    x = np.linspace(-half, half, columns)
    y = np.linspace(-half, half, lines) * lines / columns
    ways = np.stack([*np.meshgrid(x, y), np.ones((lines, columns))], axis=-1).reshape(-1, 3)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return make_transform(np.stack([right, np.cross(ahead, right), ahead], axis=1), eye_m), ways


def see(
    caster: Raycaster,
    T_world_sensor: FloatArray,
    ways: FloatArray,
    sigma_m: float,
    rng: np.random.Generator,
    farthest_m: float = np.inf,
) -> FloatArray:
    """(N, 3) points in the frame of a sensor, which are off along the ray by ``sigma_m``."""
    hits = caster.cast(T_world_sensor[:3, 3], ways @ T_world_sensor[:3, :3].T)
    seen = np.isfinite(hits.distances) & (hits.distances < farthest_m)
    ranges_m = hits.distances[seen] + rng.normal(0, sigma_m, int(seen.sum()))
    return ways[seen] * ranges_m[:, None]


def sample(
    solids: Solids, count: int, rng: np.random.Generator, sigma_m: float = 0.0
) -> FloatArray:
    """(count, 3) points spread evenly over all surfaces, as of a model: nobody stood anywhere."""
    whole = join(solids)
    corners_m = whole.vertices_m[whole.triangles]
    edges_m = corners_m[:, _FIRST_EDGE:] - corners_m[:, :1]
    areas = np.linalg.norm(np.cross(edges_m[:, 0], edges_m[:, 1]), axis=1)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    share = rng.random((count, _SECOND_EDGE))
    beyond = share.sum(axis=1) > 1
    share[beyond] = 1 - share[beyond]
    points_m = corners_m[chosen, 0] + np.einsum("pe,pei->pi", share, edges_m[chosen])
    noisy_m: FloatArray = points_m + rng.normal(0, sigma_m, points_m.shape)
    return noisy_m


def anywhere(rng: np.random.Generator, reach_m: float) -> FloatArray:
    """(4, 4) any motion, its shift within ``reach_m`` along each axis."""
    return make_transform(random_rotation(rng), rng.uniform(-reach_m, reach_m, 3))


def between(T_world_source: FloatArray, T_world_target: FloatArray) -> FloatArray:
    """(4, 4) from the source's frame to the target's."""
    return invert(T_world_target) @ T_world_source


def fused(
    solids: Solids,
    eyes_m: FloatArray,
    at_m: Place,
    sigma_m: float,
    rng: np.random.Generator,
    pixels: tuple[int, int] = (160, 150),
) -> FloatArray:
    """(N, 3) what cameras at (E, 3) places saw, in the world's frame."""
    caster, seen_m = caster_of(solids), []
    for eye_m in eyes_m:
        T_world_camera, ways = camera(eye_m, at_m, 62.0, *pixels)
        seen_m.append(
            transform_points(T_world_camera, see(caster, T_world_camera, ways, sigma_m, rng))
        )
    return np.concatenate(seen_m)
