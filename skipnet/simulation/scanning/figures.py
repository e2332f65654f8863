"""Small figures, as stand on a turntable: bodies with limbs, dented all over, and sculptures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.geometry import (
    invert,
    make_transform,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.simulation.scenes.organic import random_waves
from skipnet.simulation.scenes.raycasting import Raycaster
from skipnet.simulation.scenes.sculptures import sculpture
from skipnet.simulation.scenes.shapes import Surface, join, moved, sphere
from skipnet.types import BoolArray, FloatArray

HEIGHT_M = 0.15
"""Extent of a figure."""
SEGMENTS = 240
"""Facets around a part: finer than any voxel that a scan of it asks for."""
CAMERA_DISTANCE_M = 0.5
CAMERA_RAYS = 300
"""Rays along each side of the camera's square view ..."""
SCULPTURE_RAYS = 420
"""... that sees a sculpture; these are slim, and finely made."""
LIGHT_ASIDE_M = 0.2
"""A sculpture is seen where light falls on it, too, from so far beside the camera."""
LIGHT_SLACK = 0.003
"""Of the light's way, by which what it falls on may lie nearer."""
RANGE_SIGMA_M = 0.0001
FARTHEST_TURN_RAD = np.deg2rad(170.0)


@dataclass(frozen=True)
class Turntable:
    """A figure before a camera, the target's pose fixed and the source's turn still open."""

    caster: Raycaster
    seed: int
    T_camera_target: FloatArray
    """(4, 4): the target cloud comes in a frame turned at random about the camera."""
    T_camera_source: FloatArray
    axis: FloatArray
    """(3,) unit vector, figure frame, about which the table turns."""
    rays: int = CAMERA_RAYS
    """Along each side of the camera's view."""
    light_aside_m: float | None = None
    """What is seen is lit from so far beside the camera; None sees all."""

    def T_target_source(self, turn_rad: float) -> FloatArray:
        """(4, 4) the true motion when the table turned by ``turn_rad`` between the scans."""
        source = invert(_camera_pose(-turn_rad, self.axis) @ self.T_camera_source)
        return invert(source @ _camera_pose(0.0, self.axis) @ self.T_camera_target)

    def clouds_m(self, turn_rad: float) -> tuple[FloatArray, FloatArray]:
        """(N, 3) source and (M, 3) target, each in its own frame, the camera at the origin."""
        rng = np.random.default_rng([self.seed, 1])
        target_m = self._look(_camera_pose(0.0, self.axis), rng)
        source_m = self._look(_camera_pose(-turn_rad, self.axis), rng)
        return (
            transform_points(invert(self.T_camera_source), source_m),
            transform_points(invert(self.T_camera_target), target_m),
        )

    def _look(self, T_figure_camera: FloatArray, rng: np.random.Generator) -> FloatArray:
        """(N, 3) points in the camera's frame."""
        half = 0.6 * HEIGHT_M / CAMERA_DISTANCE_M
        side = np.linspace(-half, half, self.rays) + rng.uniform(-1, 1) * half / self.rays
        ways = np.stack([*np.meshgrid(side, side), np.ones((self.rays,) * 2)], -1).reshape(-1, 3)
        hits = self.caster.cast(T_figure_camera[:3, 3], ways @ T_figure_camera[:3, :3].T)
        seen = np.isfinite(hits.distances)
        if self.light_aside_m is not None:
            seen[seen] = self._lit(
                T_figure_camera, self.light_aside_m, ways[seen] * hits.distances[seen, None]
            )
        depth_m = hits.distances[seen] + rng.normal(0, RANGE_SIGMA_M, len(ways))[seen]
        points_m: FloatArray = ways[seen] * depth_m[:, None]
        return points_m

    def _lit(self, T_figure_camera: FloatArray, aside_m: float, points_m: FloatArray) -> BoolArray:
        """(N,) on which of (N, 3) points in the camera's frame the light falls."""
        light_m = T_figure_camera[:3, 3] + aside_m * T_figure_camera[:3, 0]
        ways_m = transform_points(T_figure_camera, points_m) - light_m
        lit: BoolArray = self.caster.cast(light_m, ways_m).distances > 1 - LIGHT_SLACK
        return lit


def turn_figure(seed: int) -> Turntable:
    """Put figure ``seed`` on the table; the same seed gives the same bits."""
    rng = np.random.default_rng([seed, 0])
    return _on_table(figure(rng), seed, rng)


def turn_sculpture(seed: int) -> Turntable:
    """Put sculpture ``seed`` on the table, before a scanner that sees what its light falls on."""
    rng = np.random.default_rng([seed, 2])
    table = _on_table(_of_height(sculpture(rng)), seed, rng)
    light_aside_m = float(rng.uniform(0.5, 1.0) * LIGHT_ASIDE_M)
    return replace(table, rays=SCULPTURE_RAYS, light_aside_m=light_aside_m)


def _on_table(parts: list[Surface], seed: int, rng: np.random.Generator) -> Turntable:
    whole = join(parts)
    axis = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.2, 3)
    return Turntable(
        caster=Raycaster(whole.vertices_m, whole.triangles),
        seed=seed,
        T_camera_target=make_transform(random_rotation(rng), np.zeros(3)),
        T_camera_source=make_transform(random_rotation(rng), np.zeros(3)),
        axis=axis / np.linalg.norm(axis),
    )


def figure(rng: np.random.Generator) -> list[Surface]:
    """A body with a head and some limbs, about the origin, ``HEIGHT_M`` high."""
    body = _part(rng, rng.uniform([0.6, 0.5, 0.9], [0.9, 0.8, 1.2]))
    parts = [body]
    for _ in range(rng.integers(3, 7)):
        limb = _part(rng, rng.uniform([0.2, 0.2, 0.3], [0.4, 0.4, 0.8]))
        at_m = body.vertices_m[rng.integers(len(body.vertices_m))]
        parts += moved([limb], make_transform(random_rotation(rng), at_m))
    return _of_height(parts)


def _of_height(parts: list[Surface]) -> list[Surface]:
    """The same about the origin, ``HEIGHT_M`` along its longest axis."""
    points_m = np.concatenate([part.vertices_m for part in parts])
    middle_m = 0.5 * (points_m.max(axis=0) + points_m.min(axis=0))
    scale = HEIGHT_M / np.ptp(points_m, axis=0).max()
    return [replace(part, vertices_m=scale * (part.vertices_m - middle_m)) for part in parts]


def _part(rng: np.random.Generator, radii_m: FloatArray) -> Surface:
    """A ball stretched to three radii, with large dents and small ones."""
    ball = sphere(1.0, SEGMENTS)[0]
    unit = ball.vertices_m - [0, 0, 1]
    dents = 0.25 * random_waves(rng, unit, least=1.5, most=5.0)
    dents += 0.06 * random_waves(rng, unit, least=6.0, most=20.0)
    return replace(ball, vertices_m=unit * (1 + dents)[:, None] * radii_m)


def _camera_pose(turn_rad: float, axis: FloatArray) -> FloatArray:
    """(4, 4) ``T_figure_camera`` of a camera that looks along its z at the figure's middle."""
    looking = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # camera's z along x of the figure
    around = rotation_from_vector(turn_rad * axis)
    return make_transform(around @ looking, around @ [-CAMERA_DISTANCE_M, 0, 0])
