"""Sensors that move: with a body that rides along, and through halls of equal bays."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import transform_points
from skipnet.simulation.scenes.shapes import moved
from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    ball,
    between,
    block,
    caster_of,
    drum,
    rings,
    see,
    upright,
)
from skipnet.types import IntArray

PLACES = ("road", "corridor", "yard")
BODIES = ("nothing", "car", "van", "operator", "mast")
CAR_RINGS = rings(1024, 32, -25.0, 12.0)
ROOM_RINGS = rings(700, 80, -50.0, 60.0)
HALL_RINGS = rings(500, 90, -50.0, 60.0)
MAP_RINGS = rings(240, 60, -50.0, 60.0)
HALL_REACH_M = 14.0


def riding(seed: int) -> Situation:
    """Two scans of a road, a corridor or a yard; a body rides with the sensor, or nothing does."""
    rng = np.random.default_rng([seed, 1])
    place, body = PLACES[seed % 3], BODIES[seed // 3 % 5]
    solids = {"road": _road, "corridor": _corridor, "yard": _yard}[place](rng)
    inside = place == "corridor"
    height_m, reach_m = (1.2, 25.0) if inside else (1.9, 100.0)
    ways, sigma_m = (ROOM_RINGS, 0.015) if inside else (CAR_RINGS, 0.02)
    step_m = rng.uniform(1.0, 4.0) if inside else rng.uniform(1.5, 9.0)
    aside_m = rng.uniform(-0.2, 0.2) if inside else rng.uniform(-2.5, 2.5)
    turn_rad = rng.uniform(-0.08, 0.08) if rng.random() < 0.7 else rng.uniform(-1.5, 1.5)
    poses = [
        upright(0.0, (0.0, aside_m, height_m)),
        upright(turn_rad, (step_m, aside_m + rng.uniform(-0.4, 0.4), height_m)),
    ]
    along = _body(body, inside)
    clouds_m = [
        see(caster_of(solids + moved(along, T)), T, ways, sigma_m, rng, reach_m) for T in poses
    ]
    name = f"riding, {place}, {body}, {step_m:.1f} m"
    return Situation(name, clouds_m[0], clouds_m[1], between(poses[0], poses[1]))


def _body(name: str, inside: bool) -> Solids:
    """In the sensor's frame."""
    if name == "operator":
        return drum(0.2, 1.5, (-0.9, 0.35, -0.4)) + ball(0.12, (-0.9, 0.35, 0.47))
    if name == "mast":
        return drum(0.05, 1.2, (-0.35, 0.0, -0.5)) + block((0.4, 0.5, 0.25), (-0.3, 0.0, -0.9))
    if name == "nothing":
        return []
    if inside:  # a trolley
        return drum(0.22, 1.1, (0.9, -0.3, -0.6)) + block((0.6, 0.45, 0.2), (0.1, 0.0, -0.7))
    if name == "car":
        return block((4.4, 1.8, 0.5), (0, 0, -1.15)) + block((1.8, 1.6, 0.3), (-0.3, 0, -0.5))
    return block((1.8, 1.8, 0.25), (0, 0, -0.55)) + block((2.2, 2.3, 2.4), (-6.2, 0, -0.7))


def _road(rng: np.random.Generator) -> Solids:
    half_m = rng.uniform(6.0, 12.0)
    solids = block((260, 110, 0.2), (0, 0, -0.1))
    for side in (-1, 1):
        solids += block((260, 0.12, rng.uniform(0.4, 0.9)), (0, side * half_m, 0.5))
    for x_m in np.arange(-90, 91, rng.uniform(20, 40)):
        solids += drum(0.12, 7.0, (x_m, half_m + 1.5, 3.5))
    for _ in range(rng.integers(0, 3)):  # signs
        size_m = rng.uniform(2, 5), 0.3, rng.uniform(1.5, 3)
        solids += block(size_m, (rng.uniform(-45, 45), rng.choice([-1, 1]) * (half_m + 2), 2.0))
    return solids


def _yard(rng: np.random.Generator) -> Solids:
    solids = block((160, 160, 0.2), (0, 0, -0.1))
    for _ in range(rng.integers(2, 6)):
        solids += drum(rng.uniform(0.15, 0.5), 4.0, (*rng.uniform(-35, 35, 2), 2.0))
    if rng.random() < 0.5:
        at_m = rng.uniform(15, 30), rng.uniform(-20, 20), 2.0
        solids += block((8, 5, 4), at_m, rng.uniform(0, 3))
    return solids


def _corridor(rng: np.random.Generator) -> Solids:
    long_m, half_m, high_m = rng.uniform(40, 70), rng.uniform(1.0, 1.6), rng.uniform(2.4, 3.0)
    solids: Solids = []
    for side in (-1, 1):
        solids += block((long_m, 0.2, high_m), (0, side * (half_m + 0.1), high_m / 2))
    for z_m in (-0.05, high_m + 0.05):
        solids += block((long_m, 2 * half_m + 0.4, 0.1), (0, 0, z_m))
    for x_m in np.arange(3 - long_m / 2, long_m / 2 - 2, rng.uniform(4, 7)):  # doors
        at_m = x_m + rng.uniform(-0.8, 0.8), rng.choice([-1, 1]) * (half_m - 0.02), 1.05
        solids += block((0.95, 0.12, 2.1), at_m)
    for _ in range(rng.integers(1, 4)):
        at_m = rng.uniform(-12, 12), rng.choice([-1, 1]) * (half_m - 0.3), 0.3
        solids += block(rng.uniform(0.3, 0.6, 3), at_m)
    return solids


def hall(seed: int) -> Situation:
    """A scan in a hall of equal bays against another one, or against the map of the hall."""
    rng = np.random.default_rng([seed, 5])
    bay_m, bays = rng.uniform(4.5, 7.0), rng.integers([5, 3], [9, 6])
    size_m = bay_m * bays
    caster = caster_of(_bays(rng, bay_m, bays))
    middle_m = (rng.integers(bays) + 0.5) * bay_m
    T_source = upright(rng.uniform(-3, 3), (*middle_m + rng.uniform(-0.4, 0.4, 2), 1.5))
    source_m = see(caster, T_source, HALL_RINGS, 0.006, rng, HALL_REACH_M)
    if seed % 2:
        away_m = rng.choice([-1, 1]) * bay_m * rng.uniform(0.3, 1.2), rng.uniform(-1, 1)
        at_m = np.clip(T_source[:2, 3] + away_m, 1.5, size_m - 1.5)
        T_target = upright(rng.uniform(-3, 3), (*at_m, 1.5))
        target_m = see(caster, T_target, HALL_RINGS, 0.006, rng, HALL_REACH_M)
        return Situation("hall, scans", source_m, target_m, between(T_source, T_target))
    stands = [upright(0.0, (*(np.array([i, j]) + 0.5) * bay_m, 1.5)) for i, j in np.ndindex(*bays)]
    map_m = np.concatenate(
        [transform_points(T, see(caster, T, MAP_RINGS, 0.006, rng, HALL_REACH_M)) for T in stands]
    )
    corner, middle = np.zeros(3), np.array([*size_m / 2, 1.5])
    origins = corner, middle, 2 * middle - [0, 0, 3], stands[0][:3, 3], middle - [0, 0, 1.5]
    T_map = upright(0.0, origins[seed // 2 % 5])
    target_m = transform_points(upright(0.0, -T_map[:3, 3]), map_m)
    return Situation("hall, map", source_m, target_m, between(T_source, T_map))


def _bays(rng: np.random.Generator, bay_m: float, bays: IntArray) -> Solids:
    """Floor, walls, columns, most often racks, and a few things that stand about."""
    x_m, y_m = bay_m * bays
    high_m = rng.uniform(4.0, 6.5)
    solids: Solids = []
    for z_m in (-0.1, high_m + 0.1):
        solids += block((x_m, y_m, 0.2), (x_m / 2, y_m / 2, z_m))
    for share in (0, 1):
        solids += block((x_m, 0.2, high_m), (x_m / 2, share * y_m, high_m / 2))
        solids += block((0.2, y_m, high_m), (share * x_m, y_m / 2, high_m / 2))
    has_racks = rng.random() < 0.6
    for i, j in np.ndindex(bays[0] - 1, bays[1] - 1):
        at_m = (i + 1) * bay_m, (j + 1) * bay_m
        solids += block((0.4, 0.4, high_m), (*at_m, high_m / 2))
        if has_racks and i < bays[0] - 2:
            solids += _rack(bay_m, at_m[0] + bay_m / 2, at_m[1])
    for _ in range(rng.integers(0, 4)):
        at_m = rng.uniform(2, x_m - 2), rng.uniform(2, y_m - 2)
        solids += block(rng.uniform(0.5, 1.5, 3), (*at_m, 0.5), rng.uniform(0, 3))
    return solids


def _rack(bay_m: float, x_m: float, y_m: float) -> Solids:
    solids: Solids = []
    for z_m in (0.3, 1.8, 3.1):
        solids += block((0.45 * bay_m, 1.0, 0.12), (x_m, y_m, z_m))
    for side in (-1, 1):
        solids += block((0.1, 1.0, 3.4), (x_m + side * 0.22 * bay_m, y_m, 1.7))
    return solids
