"""Scenes without right angles: rolling ground with rocks and trees, rooms full of lumps."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from skipnet.geometry import make_transform, random_rotation, rotation_from_vector
from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.placement import (
    CENTRE_THEN_MOVED,
    Draft,
    Maker,
    Station,
    furnish,
    square_m,
)
from skipnet.simulation.scenes.rooms import floor_pieces, rectangle, shell
from skipnet.simulation.scenes.shapes import Surface, box, cylinder, join, moved, shifted, sphere
from skipnet.types import FloatArray

HALF_TERRAIN_M = 30.0
TERRAIN_STEP_M = 0.6
LEVEL_RADIUS_M = 6.0
"""Sensors stand on level ground; the farther beyond, the higher its waves."""
LUMP_SEGMENTS = 28
WAVES = 8
"""Plane waves that a random surface is made of."""


def terrain(rng: np.random.Generator) -> Draft:
    """Rolling ground, 60 m wide, with rocks, trees and bushes, none of them regular."""
    surfaces = [_ground(rng)]
    kinds: list[Maker] = [_tree, _tree, partial(lump, radius_m=(0.3, 1.8)), _bush]
    makers = [kinds[k] for k in rng.integers(len(kinds), size=rng.integers(20, 40))]
    corners_m = square_m(np.zeros(2), HALF_TERRAIN_M - 2.0)
    pieces = furnish(rng, corners_m, makers, [square_m(np.zeros(2), 2.0)], turned_freely=True)
    stations = (Station((0.0, 0.0), 0.0, 0.5), Station((0.0, 0.0), 2.0, LEVEL_RADIUS_M - 1.0))
    return Draft(surfaces + pieces, stations)


def clutter(rng: np.random.Generator) -> Draft:
    """A small room packed with lumps, balls, drums and loaded tables."""
    half_m = rng.uniform(2.0, 3.5, 2)
    room = rectangle(-half_m, half_m, rng.uniform(2.3, 3.0), thickness_m=0.12)
    kinds: list[Maker] = [loaded_table, loaded_table, partial(lump, radius_m=(0.15, 0.5))]
    kinds += [furniture.shelf, furniture.turned_stack, furniture.ball_on_drum]
    makers = [kinds[k] for k in rng.integers(len(kinds), size=rng.integers(10, 18))]
    free = [square_m(np.zeros(2), 0.6)]
    pieces = furnish(rng, room.corners_m, makers, free, turned_freely=True)
    surfaces = [join(floor_pieces(room, {})), *shell(room, {})]
    return Draft(surfaces + pieces, CENTRE_THEN_MOVED)


def lump(rng: np.random.Generator, radius_m: tuple[float, float]) -> list[Surface]:
    """A dented, stretched ball of random size, sunk a little into what it stands on."""
    ball = sphere(1.0, LUMP_SEGMENTS)[0]
    unit = ball.vertices_m - [0, 0, 1]
    dents = random_waves(rng, unit, least=1.0, most=4.0)
    local = unit * (1 + 0.35 * dents)[:, None] * rng.uniform(0.6, 1.3, 3)
    local = local @ random_rotation(rng).T * rng.uniform(*radius_m)
    local[:, 2] -= 0.85 * local[:, 2].min()
    return [replace(ball, vertices_m=local)]


def random_waves(
    rng: np.random.Generator, points: FloatArray, least: float, most: float
) -> FloatArray:
    """(V,) a smooth random function of (V, D) points, within [-1, 1].

    Args:
        rng: draws directions, lengths and phases.
        points: where to evaluate it.
        least: smallest wave number, radians per unit of length.
        most: largest one; the shorter a wave, the lower it is.
    """
    direction = rng.normal(size=(points.shape[1], WAVES))
    direction /= np.linalg.norm(direction, axis=0)
    number = np.exp(rng.uniform(np.log(least), np.log(most), WAVES))
    height = least / number
    waves = np.cos(points @ (direction * number) + rng.uniform(0, 2 * np.pi, WAVES))
    return waves @ height / height.sum()


def _ground(rng: np.random.Generator) -> Surface:
    side = np.arange(-HALF_TERRAIN_M, HALF_TERRAIN_M + TERRAIN_STEP_M / 2, TERRAIN_STEP_M)
    xy_m = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    waves = random_waves(rng, xy_m, least=0.2, most=2.0)
    beyond_m = np.linalg.norm(xy_m, axis=1) - LEVEL_RADIUS_M
    rise = np.clip(beyond_m / LEVEL_RADIUS_M, 0, 1)
    corner = np.arange(len(side) ** 2).reshape(len(side), len(side))
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    triangles = np.concatenate(
        [np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))]
    )
    z_m = rng.uniform(1.0, 3.0) * rise * waves
    return Surface(np.column_stack([xy_m, z_m]), triangles, is_curved=True)


def _tree(rng: np.random.Generator) -> list[Surface]:
    trunk_m = rng.uniform(1.5, 4.0)
    trunk = cylinder(rng.uniform(0.1, 0.35), trunk_m + 2.0, hidden=("bottom", "top"))
    crown = lump(rng, (0.8, 2.2))
    return shifted(trunk, (0, 0, -2.0)) + shifted(crown, (0, 0, trunk_m - 0.5))


def _bush(rng: np.random.Generator) -> list[Surface]:
    return [
        surface
        for _ in range(rng.integers(2, 5))
        for surface in shifted(lump(rng, (0.3, 0.8)), (*rng.uniform(-0.8, 0.8, 2), 0))
    ]


def loaded_table(rng: np.random.Generator) -> list[Surface]:
    """A table with small things on it."""
    table = furniture.table(rng)
    top_m = max(surface.vertices_m[:, 2].max() for surface in table)
    reach_m = np.abs(np.concatenate([s.vertices_m[:, :2] for s in table])).max(axis=0) - 0.2
    things: list[Surface] = []
    for _ in range(rng.integers(3, 9)):
        thing = small_thing(rng)
        things += shifted(thing, (*rng.uniform(-reach_m, reach_m), top_m))
    return table + things


def small_thing(rng: np.random.Generator) -> list[Surface]:
    """What stands on tables: a lump, a tin or a packet."""
    small: list[Maker] = [partial(lump, radius_m=(0.06, 0.2)), _tin, _packet]
    return small[rng.integers(len(small))](rng)


def _tin(rng: np.random.Generator) -> list[Surface]:
    return cylinder(rng.uniform(0.04, 0.12), rng.uniform(0.1, 0.4), hidden=("bottom",))


def _packet(rng: np.random.Generator) -> list[Surface]:
    turn = rotation_from_vector(np.array([0, 0, rng.uniform(0, np.pi)]))
    packet = box(rng.uniform([0.1, 0.05, 0.08], [0.4, 0.25, 0.4]), hidden=("bottom",))
    return moved(packet, make_transform(turn, np.zeros(3)))
