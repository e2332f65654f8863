"""What repeats: rows of equal things, and things that look the same turned."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    between,
    block,
    camera,
    caster_of,
    drum,
    rings,
    see,
    upright,
)

ROW_RINGS = rings(420, 72, -50.0, 55.0)
REACH_PERIODS = (4.0, 9.0)
SIDES = (3, 4, 6)


def row(seed: int) -> Situation:
    """Two scans, some periods apart, of a carriage, a colonnade or a duct with equal frames; what
    lies about there tells the places apart, or nothing does."""
    rng = np.random.default_rng([seed, 9])
    name, make = ROWS[seed % len(ROWS)]
    period_m = rng.uniform(0.8, 1.1) if make is _carriage else rng.uniform(1.5, 4.5)
    caster = caster_of(make(rng, period_m))
    step_m = rng.uniform(0.7, 2.5) * period_m
    poses = [
        upright(rng.uniform(-3, 3), (x_m, rng.uniform(-0.15, 0.15), 1.4)) for x_m in (0.0, step_m)
    ]
    reach_m = max(rng.uniform(*REACH_PERIODS) * period_m, 4.0)
    source_m, target_m = (see(caster, T, ROW_RINGS, 0.005, rng, reach_m) for T in poses)
    T = between(poses[0], poses[1])
    return Situation(f"row, {name}, {step_m / period_m:.1f} periods", source_m, target_m, T)


def _carriage(rng: np.random.Generator, period_m: float) -> Solids:
    solids = block((22, 2.9, 0.1), (0, 0, -0.05)) + block((22, 2.9, 0.1), (0, 0, 2.35))
    for side in (-1, 1):
        for z_m, high_m in ((0.45, 0.9), (2.1, 0.4)):
            solids += block((22, 0.1, high_m), (0, side * 1.45, z_m))
        for x_m in np.arange(-10, 10, 2 * period_m):
            solids += block((0.3, 0.1, 0.9), (x_m, side * 1.45, 1.4))
        for x_m in np.arange(-9, 9.1, period_m):
            solids += block((0.45, 0.95, 0.45), (x_m, side * 0.9, 0.22))
            solids += block((0.1, 0.95, 0.8), (x_m - 0.25, side * 0.9, 0.8))
    for _ in range(rng.integers(0, 3)):
        solids += block((0.3, 0.5, 0.25), (rng.uniform(-3, 3), 0.9, 0.6))
    return solids


def _colonnade(rng: np.random.Generator, period_m: float) -> Solids:
    solids = block((120, 30, 0.2), (0, 0, -0.1)) + block((90, 0.4, 6), (0, 2.5, 3))
    solids += block((90, 4.4, 0.3), (0, 0.4, 5.2))
    for x_m in np.arange(-10, 11) * period_m:
        solids += drum(0.3, 5, (x_m, -1.6, 2.5)) + block((0.9, 0.9, 0.3), (x_m, -1.6, 0.15))
        solids += block((0.5, 0.2, 5), (x_m, 2.3, 2.5))
    for _ in range(rng.integers(0, 3)):
        at_m = rng.uniform(-8, 8), rng.uniform(-8, -4), 0.4
        solids += block(rng.uniform(0.4, 1.2, 3), at_m, rng.uniform(0, 3))
    return solids


def _duct(rng: np.random.Generator, period_m: float) -> Solids:
    half_m = rng.uniform(1.2, 2.5)
    solids: Solids = []
    for z_m in (-0.05, 2 * half_m + 0.05):
        solids += block((60, 2 * half_m, 0.1), (0, 0, z_m))
    for side in (-1, 1):
        solids += block((60, 0.1, 2 * half_m), (0, side * half_m, half_m))
        for x_m in np.arange(-9, 10) * period_m:
            solids += block((0.15, 0.12, 2 * half_m), (x_m, side * (half_m - 0.06), half_m))
    for x_m in np.arange(-9, 10) * period_m:
        solids += block((0.15, 2 * half_m, 0.12), (x_m, 0, 2 * half_m - 0.06))
    for _ in range(rng.integers(0, 3)):
        solids += block(rng.uniform(0.2, 0.4, 3), (rng.uniform(-8, 8), half_m - 0.3, 0.3))
    return solids


ROWS: tuple[tuple[str, Callable[[np.random.Generator, float], Solids]], ...] = (
    ("carriage", _carriage),
    ("colonnade", _colonnade),
    ("duct", _duct),
)


def pedestal(seed: int) -> Situation:
    """Something of no symmetry on a base of three, four or six equal sides, seen from two sides."""
    rng = np.random.default_rng([seed, 10])
    count = SIDES[seed % len(SIDES)]
    solids = block((30, 30, 0.2), (0, 0, -0.1))
    for angle in 2 * np.pi * np.arange(count) / count:
        way = np.array([np.cos(angle), np.sin(angle)])
        solids += block((0.12, 1.0, 1.2), (*0.8 * way, 0.6), angle)
        solids += drum(0.12, 1.6, (*1.2 * way, 0.8))
    for _ in range(rng.integers(1, 4)):
        at_m = *rng.uniform(-0.4, 0.4, 2), 1.35
        solids += block(rng.uniform(0.15, 0.5, 3), at_m, rng.uniform(0, 3))
    caster = caster_of(solids)
    start_rad, apart_rad = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(40, 130))
    clouds_m, poses = [], []
    for angle in (start_rad, start_rad + apart_rad):
        eye_m = np.array([5 * np.cos(angle), 5 * np.sin(angle), rng.uniform(1.6, 2.6)])
        T, ways = camera(eye_m, (0, 0, 0.8), 55.0, 220, 165)
        clouds_m.append(see(caster, T, ways, 0.004, rng, 12.0))
        poses.append(T)
    name = f"pedestal, {count} sides, {np.rad2deg(apart_rad):.0f} deg"
    return Situation(name, clouds_m[0], clouds_m[1], between(poses[0], poses[1]))
