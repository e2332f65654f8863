"""Scans against models, and large surfaces that hold a pose by little: hills, tanks."""

from __future__ import annotations

import numpy as np

from skipnet.geometry import transform_points
from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    between,
    block,
    caster_of,
    drum,
    rings,
    sample,
    see,
    upright,
)
from skipnet.types import FloatArray

MODEL_POINTS = 90_000
FIELD_M = (200.0, 150.0)
WAVES = 12
_ROOM_RINGS, _YARD_RINGS = rings(400, 150, -55.0, 60.0), rings(1800, 16, -15.0, 15.0)
_TANK_RINGS = rings(360, 120, -60.0, 60.0)
_UP = np.array([[0.0, 0.0, 1.0]])
_TRIES = 50


def model(seed: int) -> Situation:
    """A scan of a room, or of a yard by 16 lines, against points sampled from the model."""
    rng = np.random.default_rng([seed, 6])
    solids = _yard(rng) if seed % 2 else _room(rng)
    caster, reach_m = caster_of(solids), (12.0 if seed % 2 else 0.8)
    for _ in range(_TRIES):
        place_m = np.array([*rng.uniform(-reach_m, reach_m, 2), 1.2 if seed % 2 else 1.5])
        if seed % 2 == 0 or not np.isfinite(caster.cast(place_m, _UP).distances[0]):
            break  # under the sky, or in the room
    T = upright(rng.uniform(-3, 3), place_m)
    ways, sigma_m = (_YARD_RINGS, 0.02) if seed % 2 else (_ROOM_RINGS, 0.004)
    source_m = see(caster, T, ways, sigma_m, rng, 60.0)
    shift_m = rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-8, 8, 3)
    T_model = upright(0.0, -shift_m)
    target_m = sample(solids, MODEL_POINTS, rng) + shift_m
    name = "model, yard" if seed % 2 else "model, room"
    return Situation(name, source_m, target_m, between(T, T_model))


def _room(rng: np.random.Generator) -> Solids:
    x_m, y_m, z_m = rng.uniform([5, 4, 2.5], [9, 7, 3.2])
    solids = block((x_m, y_m, 0.1), (0, 0, -0.05)) + block((x_m, y_m, 0.1), (0, 0, z_m + 0.05))
    for side in (-1, 1):
        solids += block((x_m, 0.1, z_m), (0, side * y_m / 2, z_m / 2))
    solids += block((0.1, y_m, z_m), (x_m / 2, 0, z_m / 2))
    solids += block((0.1, 0.6 * y_m, z_m), (-x_m / 2, -0.2 * y_m, z_m / 2))
    for _ in range(rng.integers(3, 7)):
        at_m = rng.uniform(-0.42, 0.42) * x_m, rng.uniform(-0.42, 0.42) * y_m, 0.4
        turn_rad = rng.choice([0.0, 0.0, rng.uniform(0, 3)])
        solids += block(rng.uniform([0.4, 0.4, 0.4], [1.6, 0.9, 2.0]), at_m, turn_rad)
    return solids


def _yard(rng: np.random.Generator) -> Solids:
    solids = block((70, 70, 0.2), (0, 0, -0.1))
    for _ in range(rng.integers(4, 8)):
        at_m = rng.uniform(-20, 20, 2)
        near_m = float(np.linalg.norm(at_m))
        at_m *= max(1.0, 8 / max(near_m, 1e-3)) if near_m < 6 else 1.0
        kind = rng.random()
        if kind < 0.6:
            solids += block(rng.uniform([4, 4, 4], [14, 12, 10]), (*at_m, 3), rng.uniform(0, 3))
        elif kind < 0.8:
            solids += drum(rng.uniform(0.3, 1.5), 4.0, (*at_m, 2))
        else:
            solids += block((2.8, 1.6, 2.0), (*at_m, 1), rng.uniform(0, 3))
    return solids


def ground(seed: int) -> Situation:
    """Gentle hills from the air, in part seen twice: half a voxel is much on them."""
    rng = np.random.default_rng([seed, 7])
    high_m, phase = rng.uniform(0.5, 8.0), rng.uniform(0, 2 * np.pi, WAVES)
    rate = rng.uniform(0.01, 0.07, (WAVES, 2)) * rng.choice([-1, 1], (WAVES, 2))
    strength = rng.uniform(0.3, 1.0, WAVES)
    own, sigma_m = rng.uniform(0, 0.45), rng.uniform(0.02, 0.08)

    def fly(first_share: float, last_share: float) -> FloatArray:
        """(50,000, 3) points of a strip."""
        low_m, wide_m = first_share * FIELD_M[0], FIELD_M
        xy_m = rng.uniform([low_m, 0], [last_share * wide_m[0], wide_m[1]], (50_000, 2))
        z_m = high_m / 3 * np.sin(xy_m @ rate.T + phase) @ strength
        return np.column_stack([xy_m, z_m + rng.normal(0, sigma_m, len(z_m))])

    T = upright(rng.uniform(-3, 3), rng.uniform(-50, 50, 3))
    source_m, target_m = fly(0.0, 1 - own), fly(own, 1.0)
    name = f"ground, {high_m:.1f} m, {1 - 2 * own:.2f}"
    return Situation(name, source_m, transform_points(T, target_m), T)


def tank(seed: int) -> Situation:
    """Two scans inside a round tank, in which a few things stand at the wall."""
    rng = np.random.default_rng([seed, 8])
    radius_m = rng.uniform(2, 6)
    solids = drum(radius_m, 8.0, (0, 0, 3))
    solids += block((2.4 * radius_m, 2.4 * radius_m, 0.1), (0, 0, -0.05))
    for _ in range(rng.integers(1, 4)):
        angle, size_m = rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 1.2, 3)
        at_m = 0.95 * radius_m * np.array([np.cos(angle), np.sin(angle)])
        solids += block(size_m, (*at_m, rng.uniform(0.3, 1.5)), angle)
    caster = caster_of(solids)
    poses = [
        upright(rng.uniform(-3, 3), (*rng.uniform(-0.15, 0.15, 2) * radius_m, 1.5))
        for _ in range(2)
    ]
    clouds_m = [see(caster, T, _TANK_RINGS, 0.005, rng) for T in poses]
    return Situation("tank", clouds_m[0], clouds_m[1], between(poses[0], poses[1]))
