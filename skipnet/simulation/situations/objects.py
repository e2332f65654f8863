"""Objects that are alike: arches and rings of blocks, machined parts, mirrored, others, in part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import transform_points
from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    anywhere,
    ball,
    between,
    block,
    camera,
    caster_of,
    drum,
    fused,
    sample,
    scaled,
    see,
)
from skipnet.types import FloatArray

ARCH_MODES = ("halves", "halves", "mirrored", "other", "halves", "whole")
PART_MODES = ("same", "mirrored", "other", "band", "view")
FLIPPED = np.array([1.0, -1.0, 1.0])
ARCH_EYES_M = np.array([(0, 15, 90), (45, 60, 45), (-45, 60, 40), (0, -45, 50), (0, 95, 35)], float)
"""Lengths of arches and parts are in any unit: some come in millimetres."""


@dataclass(frozen=True)
class Arch:
    """What blocks stand along a curve; each specimen has its own jitter."""

    blocks: int
    half_m: tuple[float, float]
    size_m: float
    height_m: float
    tube_m: float
    knob: int
    """0 for none, 1 for balls, 2 for drums on the blocks."""
    is_ring: bool

    def specimen(self, rng: np.random.Generator) -> Solids:
        """One of the kind."""
        full_rad, (a_m, b_m) = 2 * np.pi if self.is_ring else np.pi, self.half_m
        solids: Solids = []
        for k in range(self.blocks):
            angle = full_rad * (k if self.is_ring else k + 0.5) / self.blocks
            at_m = [a_m * np.cos(angle), b_m * np.sin(angle)] + rng.uniform(-0.02, 0.02, 2) * a_m
            solids += self._tooth(k, at_m, angle, rng)
        for angle in np.linspace(0, full_rad, 60):
            at_m = a_m * np.cos(angle), b_m * np.sin(angle), -0.4 * self.tube_m
            solids += ball(self.tube_m, at_m)
        return solids

    def _tooth(self, k: int, at_m: FloatArray, angle: float, rng: np.random.Generator) -> Solids:
        middle = (self.blocks - 1) / 2
        wider = 0.12 * (k % 3) if self.is_ring else 0.5 * abs(k - middle) / self.blocks
        width_m, high_m = self.size_m * (1 + wider), self.height_m * rng.uniform(0.92, 1.08)
        turn_rad = angle + rng.uniform(-0.14, 0.14)
        solids = block((width_m, 0.8 * width_m, high_m), (*at_m, high_m / 2), turn_rad)
        if self.knob == 1:
            solids += ball(0.36 * width_m, (*at_m, high_m))
        if self.knob == 2:
            solids += drum(0.3 * width_m, 0.5 * high_m, (*at_m, 1.1 * high_m))
        return solids


def arch(seed: int) -> Situation:
    """Two overlapping parts of an arch or ring of blocks, or its mirror image, or another one."""
    rng = np.random.default_rng([seed, 2])
    mode = ARCH_MODES[seed % len(ARCH_MODES)]
    kind, specimen = draw_arch(rng), int(rng.integers(1 << 30))
    solids = kind.specimen(np.random.default_rng(specimen))
    other = kind.specimen(np.random.default_rng(specimen + 1)) if mode == "other" else solids
    T = anywhere(rng, 40.0)
    source_m, target_m = (look_at_arch(one, kind.is_ring, rng) for one in (solids, other))
    if mode == "halves":
        full_rad = 2 * np.pi if kind.is_ring else np.pi
        end_rad = full_rad * rng.uniform(0.5, 0.85)
        start_rad = max(end_rad - full_rad * rng.uniform(0.12, 0.5), 0.05)
        source_m = source_m[_angle_rad(source_m, kind) < end_rad]
        target_m = target_m[_angle_rad(target_m, kind) > start_rad]
    if mode == "mirrored":
        source_m = source_m * FLIPPED
    truth = T if mode in ("halves", "whole") else None
    name = f"{'ring' if kind.is_ring else 'arch'}, {mode}"
    return Situation(name, source_m, transform_points(T, target_m), truth)


def draw_arch(rng: np.random.Generator) -> Arch:
    """A kind of arch, or of ring."""
    is_ring = bool(rng.random() < 0.35)
    half_m = (38.0, 38.0) if is_ring else (rng.uniform(22, 34), rng.uniform(30, 44))
    return Arch(
        blocks=int(rng.integers(10, 20)),
        half_m=half_m,
        size_m=rng.uniform(3.5, 5.5),
        height_m=rng.uniform(6, 10),
        tube_m=rng.uniform(4, 7),
        knob=int(rng.integers(0, 3)),
        is_ring=is_ring,
    )


def look_at_arch(solids: Solids, is_ring: bool, rng: np.random.Generator) -> FloatArray:
    """(N, 3) points of a ring's surface, or what five cameras see of an arch."""
    if is_ring:
        return sample(solids, 40_000, rng, 0.05)
    eyes_m = ARCH_EYES_M + rng.uniform(-5, 5, ARCH_EYES_M.shape)
    return fused(solids, eyes_m, (0, 18, 2), 0.03, rng)


def _angle_rad(points_m: FloatArray, kind: Arch) -> FloatArray:
    """(N,) where along the curve points lie."""
    angle: FloatArray = np.arctan2(points_m[:, 1] / kind.half_m[1], points_m[:, 0] / kind.half_m[0])
    return np.mod(angle, 2 * np.pi)


def part(seed: int) -> Situation:
    """Samples of a machined part and of it again, mirrored, another one, in part, or a view."""
    rng = np.random.default_rng([seed, 3])
    mode, unit = PART_MODES[seed % len(PART_MODES)], rng.choice([0.002, 0.01, 1.0])
    size = np.array([120.0, rng.uniform(50, 80), rng.uniform(30, 70)])
    bosses, specimen = int(rng.integers(2, 5)), int(rng.integers(1 << 30))
    solids = scaled(bracket(size, bosses, np.random.default_rng(specimen)), unit)
    sigma_m, T = rng.uniform(0.03, 0.1) * unit, anywhere(rng, 60 * unit)
    count = 40_000 if mode == "band" else 16_000
    source_m, target_m = (sample(solids, count, rng, sigma_m) for _ in range(2))
    if mode == "mirrored":
        return Situation("part, mirrored", source_m * FLIPPED, transform_points(T, target_m), None)
    if mode == "other":
        other = bracket(size, bosses - 1, np.random.default_rng(specimen))
        other += boss(size, rng)
        target_m = sample(scaled(other, unit), count, rng, sigma_m)
        return Situation("part, other", source_m, transform_points(T, target_m), None)
    if mode == "band":
        half, at = 0.5 * rng.uniform(0.1, 0.3) * size[0], rng.uniform(-0.2, 0.2) * size[0]
        source_m = source_m[source_m[:, 0] > unit * (at - half)]
        target_m = target_m[target_m[:, 0] < unit * (at + half)]
    if mode == "view":
        eye = np.array([rng.uniform(-1, 1), -1.6, rng.uniform(0.8, 1.5)]) * size[0] * unit
        T_eye, ways = camera(eye, (0, 0, 0.3 * size[2] * unit), 50.0, 240, 200)
        target_m = see(caster_of(solids), T_eye, ways, sigma_m, rng)
        return Situation("part, view", source_m, target_m, between(np.eye(4), T_eye))
    return Situation(f"part, {mode}", source_m, transform_points(T, target_m), T)


def bracket(size: FloatArray, bosses: int, rng: np.random.Generator) -> Solids:
    """A plate and a wall behind it, of a (3,) size, with bosses at random."""
    wide, deep, high = size
    solids = block((wide, deep, 0.15 * high), (0, 0, 0.07 * high))
    solids += block((wide, 0.15 * high, high), (0, 0.45 * deep, 0.5 * high))
    for _ in range(bosses):
        solids += boss(size, rng)
    return solids


def boss(size: FloatArray, rng: np.random.Generator) -> Solids:
    """A drum or a block somewhere on the plate of a bracket."""
    at = rng.uniform(-0.4, 0.4) * size[0], rng.uniform(-0.4, 0.3) * size[1]
    if rng.random() < 0.5:
        radius, high = rng.uniform(0.05, 0.12) * size[0], rng.uniform(0.2, 0.6) * size[2]
        return drum(radius, high, (*at, 0.3 * size[2]))
    sides = rng.uniform(0.06, 0.25, 3) * size[0]
    return block(sides, (*at, 0.25 * size[2]), rng.uniform(0, 3))


def table(seed: int) -> Situation:
    """A few small things on a large plane, seen by a camera from two sides."""
    rng = np.random.default_rng([seed, 4])
    solids, scale = block((4, 4, 0.03), (0, 0, -0.015)), rng.choice([1.0, 1.0, 8.0])
    for first in range(int(rng.integers(1, 5))):
        solids += _thing(rng, rng.uniform(-0.2, 0.2, 2) if first else rng.uniform(-0.04, 0.04, 2))
    if rng.random() < 0.25:
        solids += block((4, 0.03, 2), (0, 0.6, 1))
    caster = caster_of(scaled(solids, scale))
    start_rad, apart_rad = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(12, 80))
    clouds_m, poses = [], []
    for angle in (start_rad, start_rad + apart_rad):
        away_m = rng.uniform(0.7, 0.9)
        eye_m = np.array([away_m * np.cos(angle), away_m * np.sin(angle), rng.uniform(0.4, 0.6)])
        T, ways = camera(scale * eye_m, (0, 0, 0.05 * scale), rng.uniform(45, 60), 300, 220)
        sigma_m = rng.uniform(0.0007, 0.0015) * scale
        clouds_m.append(see(caster, T, ways, sigma_m, rng, 3.0 * scale))
        poses.append(T)
    name = f"table, {np.rad2deg(apart_rad):.0f} deg"
    return Situation(name, clouds_m[0], clouds_m[1], between(poses[0], poses[1]))


def _thing(rng: np.random.Generator, at_m: FloatArray) -> Solids:
    turn_rad = rng.uniform(0, 3)
    kind = rng.integers(4)
    if kind == 0:
        size_m = rng.uniform([0.03, 0.03, 0.04], [0.12, 0.12, 0.2])
        return block(size_m, (*at_m, size_m[2] / 2), turn_rad)
    if kind == 1:  # a mug
        radius_m, high_m = rng.uniform(0.02, 0.05), rng.uniform(0.06, 0.2)
        mug = drum(radius_m, high_m, (*at_m, high_m / 2))
        return mug + block((0.03, 0.02, 0.03), (at_m[0] + radius_m + 0.01, at_m[1], 0.05))
    if kind == 2:
        radius_m = rng.uniform(0.03, 0.07)
        beside_m = at_m[0] + 0.03, at_m[1] + 0.02, 0.08
        return ball(radius_m, (*at_m, radius_m)) + block((0.04, 0.09, 0.1), beside_m, turn_rad)
    upright_m, foot_m = (0.1, 0.02, 0.16), (0.02, 0.08, 0.05)
    return block(upright_m, (*at_m, 0.08), turn_rad) + block(foot_m, (*at_m, 0.025), turn_rad)
