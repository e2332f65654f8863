"""Sculptures: people in robes, animals, serpents, vases and busts, from tubes along curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from skipnet.simulation.scenes.organic import random_waves
from skipnet.simulation.scenes.shapes import Surface, sphere
from skipnet.types import FloatArray

RINGS, SEGMENTS = 72, 120
"""Of a tube: along its curve, and around it."""
BALL_SEGMENTS = 60
UP = np.array([0.0, 0.0, 1.0])

Points = Sequence[Sequence[float] | FloatArray] | FloatArray


def sculpture(rng: np.random.Generator) -> list[Surface]:
    """One of any kind, one or two units high; its parts run into one another."""
    kinds = (_person, _person, _person, _animal, _serpent, _vase, _bust)
    parts = kinds[rng.integers(len(kinds))](rng)
    return [_dented(part, rng) for part in parts]


def tube(
    spine_m: FloatArray, radii_m: FloatArray, relief: FloatArray | float = 0.0, flat: float = 1.0
) -> Surface:
    """What an outline sweeps along a curve.

    Args:
        spine_m: (R, 3) points of the curve.
        radii_m: (R,) of the outline at each; hardly any closes an end.
        relief: (R, SEGMENTS) how much farther out each point of an outline lies, as a share.
        flat: so many times as wide as thick is the outline.
    """
    along = np.gradient(spine_m, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    wide = _carried(along)
    thick = np.cross(along, wide) / flat
    angle = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    ways = np.cos(angle)[:, None] * wide[:, None] + np.sin(angle)[:, None] * thick[:, None]
    outer_m = radii_m[:, None] * (1 + np.asarray(relief))
    vertices_m = spine_m[:, None] + np.broadcast_to(outer_m, ways.shape[:2])[..., None] * ways
    corner = np.arange(len(spine_m) * SEGMENTS).reshape(-1, SEGMENTS)
    east = np.roll(corner, -1, axis=1)
    lower = np.stack([corner[:-1], east[:-1], east[1:]], axis=-1)
    upper = np.stack([corner[:-1], east[1:], corner[1:]], axis=-1)
    triangles = np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
    return Surface(vertices_m.reshape(-1, 3), triangles, is_curved=True)


def _carried(along: FloatArray) -> FloatArray:
    """(R, 3) unit vectors across (R, 3) directions, from one to the next turned no more than
    needed."""
    across = np.tile(np.eye(3)[np.argmin(np.abs(along[0]))], (len(along), 1))
    for row, way in enumerate(along):
        carried = across[max(row - 1, 0)]
        carried = carried - carried @ way * way
        across[row] = carried / np.linalg.norm(carried)
    return across


def _curve(through_m: Points) -> FloatArray:
    """(RINGS, 3) a smooth curve through some points."""
    through = np.asarray(through_m, dtype=np.float64)
    curve: FloatArray = CubicSpline(np.linspace(0, 1, len(through)), through)(_share())
    return curve


def _profile(radii_m: Sequence[float] | FloatArray, closing: float = 0.04) -> FloatArray:
    """(RINGS,) radii that pass through some, evenly spaced, and round off at both ends."""
    radii = PchipInterpolator(np.linspace(0, 1, len(radii_m)), radii_m)(_share())
    to_end = np.minimum(np.minimum(_share(), 1 - _share()) / closing, 1)
    closed: FloatArray = radii * np.maximum(np.sqrt(1 - (1 - to_end) ** 2), 1e-3)
    return closed


def _share() -> FloatArray:
    return np.linspace(0, 1, RINGS)


def _folds(rng: np.random.Generator, deepest: float) -> FloatArray:
    """(RINGS, SEGMENTS) relief of cloth that hangs: folds that run along and wander about."""
    around = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)[None]
    along = _share()[:, None]
    relief = np.zeros((RINGS, SEGMENTS))
    for _ in range(rng.integers(2, 6)):
        number, wander = rng.integers(2, 15), rng.normal(0, 3)
        rises = 0.5 + 0.5 * np.cos(np.pi * rng.uniform(0.5, 3) * along + rng.uniform(0, 6))
        phase = rng.uniform(0, 2 * np.pi) + wander * along**2
        relief += rises * np.cos(number * around + phase) / np.sqrt(number)
    return deepest * relief / np.abs(relief).max()


def _dented(part: Surface, rng: np.random.Generator) -> Surface:
    """The same, uneven all over, coarsely and finely."""
    points_m = part.vertices_m
    shift_m = [
        height_m * np.stack([random_waves(rng, points_m, least, 6 * least) for _ in range(3)], 1)
        for height_m, least in ((0.03, 4.0), (0.012, 16.0), (0.006, 50.0))
    ]
    return replace(part, vertices_m=points_m + rng.uniform(0.2, 1.2) * sum(shift_m))


def _ball(at_m: FloatArray, radii_m: FloatArray | float) -> Surface:
    ball = sphere(1.0, BALL_SEGMENTS)[0]
    return replace(ball, vertices_m=(ball.vertices_m - UP) * radii_m + at_m)


def _plinth(rng: np.random.Generator, radius_m: float) -> list[Surface]:
    """A round one with mouldings, or a rounded block, below the origin."""
    high_m = rng.uniform(0.05, 0.3)
    radii_m = radius_m * rng.uniform(0.8, 1.15, rng.integers(3, 8))
    relief: FloatArray | float = 0.0
    if rng.random() < 0.4:  # as a square is from its middle
        angle = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False) + 0.1
        relief = (np.abs(np.cos(angle)) ** 8 + np.abs(np.sin(angle)) ** 8)[None] ** (-1 / 8) - 1
    spine = _curve([(0, 0, -high_m), (0, 0, 0.02)])
    return [tube(spine, _profile(radii_m), relief, flat=rng.uniform(0.9, 1.3))]


def _person(rng: np.random.Generator) -> list[Surface]:
    """Standing, in a robe, arms anywhere, some cloth hanging from them."""
    hem, waist, chest = rng.uniform(0.16, 0.34), rng.uniform(0.1, 0.2), rng.uniform(0.14, 0.24)
    lean = rng.normal(0, 0.05, (3, 3)) * [1, 1, 0]
    spine = _curve([(0, 0, 0), lean[0] + 0.4 * UP, lean[1] + 0.75 * UP, lean[1] + UP])
    robe = _profile([hem, rng.uniform(0.8, 1.1) * hem, waist, waist, chest, chest, 0.08])
    parts = [tube(spine, robe, _folds(rng, rng.uniform(0.05, 0.3)), flat=rng.uniform(1, 1.7))]
    head_m = lean[1] + [0, 0, 1.08 + rng.uniform(0, 0.05)]
    parts += _head(rng, head_m, rng.uniform(0.08, 0.13))
    for side in (-1, 1):
        shoulder_m = lean[1] + [0, side * 0.8 * chest, rng.uniform(0.85, 0.95)]
        parts += _arm(rng, shoulder_m, side)
    return parts + (_plinth(rng, hem * rng.uniform(1.1, 1.5)) if rng.random() < 0.8 else [])


def _arm(rng: np.random.Generator, shoulder_m: FloatArray, side: int) -> list[Surface]:
    """An arm in its sleeve, perhaps with something in the hand and cloth that hangs down."""
    elbow_m = shoulder_m + rng.normal([0.05, side * 0.15, -0.12], [0.12, 0.06, 0.15])
    hand_m = elbow_m + rng.normal([0.12, -side * 0.02, 0.05], [0.12, 0.12, 0.2])
    thick_m = rng.uniform(0.04, 0.07)
    radii = _profile(thick_m * np.array([1.2, 1, 0.9, rng.uniform(0.7, 1.6), 0.6]))
    parts = [tube(_curve([shoulder_m, elbow_m, hand_m]), radii, _folds(rng, 0.15))]
    parts.append(_ball(hand_m, rng.uniform(0.03, 0.06, 3)))
    if rng.random() < 0.4:
        parts.append(_ball(hand_m + 0.06 * UP, rng.uniform(0.04, 0.1, 3)))
    if rng.random() < 0.6:
        falls_m = [elbow_m, *(elbow_m - rng.uniform(0.05, 0.3, (3, 1)).cumsum(axis=0) * UP)]
        falls_m = [falls_m[0], *(at + rng.normal(0, 0.04, 3) for at in falls_m[1:])]
        cloth = _profile(rng.uniform(0.03, 0.1, 4))
        parts.append(tube(_curve(falls_m), cloth, _folds(rng, 0.2), flat=rng.uniform(2, 7)))
    return parts


def _head(rng: np.random.Generator, at_m: FloatArray, radius_m: float) -> list[Surface]:
    """With a nose, hair in lumps or a hat."""
    parts = [_ball(at_m, radius_m * rng.uniform([0.8, 0.8, 1], [1.1, 1, 1.3]))]
    ahead = np.array([1.0, rng.normal(0, 0.3), rng.normal(0, 0.15)])
    nose_m = [at_m + 0.8 * radius_m * ahead, at_m + 1.25 * radius_m * (ahead - 0.15 * UP)]
    parts.append(tube(_curve(nose_m), _profile(radius_m * np.array([0.25, 0.2, 0.15]), 0.3)))
    if rng.random() < 0.5:
        top_m = [at_m + 0.5 * radius_m * UP, at_m + rng.uniform(1.2, 2.2) * radius_m * UP]
        parts.append(tube(_curve(top_m), _profile(radius_m * rng.uniform(0.3, 1.3, 4), 0.1)))
    for _ in range(rng.integers(0, 9)):
        way = rng.normal(size=3)
        lump_m = at_m + 0.9 * radius_m * way / np.linalg.norm(way)
        parts.append(_ball(lump_m, radius_m * rng.uniform(0.15, 0.45, 3)))
    return parts


def _animal(rng: np.random.Generator) -> list[Surface]:
    """On four legs, upon a rock."""
    high, long, thick = rng.uniform(0.4, 0.7), rng.uniform(0.5, 0.9), rng.uniform(0.12, 0.25)
    back = _curve([(-long / 2, 0, high), (0, 0, high + rng.normal(0, 0.06)), (long / 2, 0, high)])
    parts = [tube(back, _profile(thick * rng.uniform(0.7, 1.1, 4), 0.12), _folds(rng, 0.1))]
    for x in (-0.4 * long, 0.4 * long):
        for y in (-0.6 * thick, 0.6 * thick):
            foot_m = np.array([x, y, 0]) + rng.normal(0, 0.08, 3) * [1, 0.3, 0]
            leg = _curve([(x, y, high), (x + rng.normal(0, 0.05), y, high / 2), foot_m])
            parts.append(tube(leg, _profile(thick * np.array([0.6, 0.4, 0.25, 0.3]))))
    head_m = np.array([long / 2 + rng.uniform(0.1, 0.3), rng.normal(0, 0.1), high + 0.3])
    neck = _profile(thick * rng.uniform([0.6, 0.4, 0.4], [0.9, 0.7, 0.6]))
    parts.append(tube(_curve([(0.4 * long, 0, high), head_m - 0.1 * UP, head_m]), neck))
    parts += _head(rng, head_m, thick * rng.uniform(0.5, 0.9))
    tail_m = [
        (-long / 2, 0, high),
        *(np.cumsum(rng.normal(-0.1, 0.12, (3, 3)), 0) + [-long / 2, 0, high]),
    ]
    parts.append(tube(_curve(tail_m), _profile([0.06, 0.04, 0.05, 0.02])))
    return [*parts, _ball(np.array([0, 0, -0.12]), np.array([0.7 * long, 1.5 * thick, 0.18]))]


def _serpent(rng: np.random.Generator) -> list[Surface]:
    """Wound about, with a crest of spikes, upon a plinth."""
    turns = np.cumsum(rng.normal(1.3, 0.4, 7))
    at_m = np.stack([0.35 * np.cos(turns), 0.25 * np.sin(turns), np.linspace(0.05, 0.9, 7)], 1)
    spine = _curve(at_m + rng.normal(0, 0.06, at_m.shape))
    radii = _profile(rng.uniform(0.08, 0.16) * np.array([0.3, 0.8, 1.1, 1, 0.9, 0.6]))
    parts = [tube(spine, radii, _folds(rng, 0.12)), *_head(rng, spine[-1], 0.13)]
    for row in range(6, RINGS - 6, int(rng.integers(5, 9))):
        tip_m = spine[row] + 2.2 * radii[row] * (UP + rng.normal(0, 0.3, 3))
        spike = _profile(radii[row] * np.array([0.5, 0.3, 0.1]), 0.1)
        parts.append(tube(_curve([spine[row], tip_m]), spike, flat=2.0))
    return parts + _plinth(rng, 0.45)


def _vase(rng: np.random.Generator) -> list[Surface]:
    """With a relief, handles and knobs."""
    radii = _profile(rng.uniform(0.12, 0.4, 6))
    spine = _curve([(0, 0, 0), UP])
    parts = [tube(spine, radii, _folds(rng, rng.uniform(0.0, 0.08)), flat=rng.uniform(1, 1.2))]
    for _ in range(rng.integers(1, 5)):
        low, high = sorted(rng.uniform(0.15, 0.85, 2))
        way = np.array([np.cos(a := rng.uniform(0, 6.3)), np.sin(a), 0.0])
        wide_m = radii[[int(low * RINGS), int(high * RINGS)]]
        handle = [low * UP + 0.9 * wide_m[0] * way, high * UP + 0.9 * wide_m[1] * way]
        middle = handle[0] / 2 + handle[1] / 2 + rng.uniform(0.1, 0.35) * way
        ring = _profile(rng.uniform(0.02, 0.06, 3))
        parts.append(tube(_curve([handle[0], middle, handle[1]]), ring, flat=rng.uniform(1, 2)))
    for _ in range(rng.integers(3, 25)):
        row, a = rng.integers(RINGS), rng.uniform(0, 6.3)
        at_m = spine[row] + radii[row] * np.array([np.cos(a), np.sin(a), 0.0])
        parts.append(_ball(at_m, rng.uniform(0.02, 0.1, 3)))
    return parts


def _bust(rng: np.random.Generator) -> list[Surface]:
    """A head on shoulders, larger than life beside a person."""
    chest = _profile(rng.uniform([0.15, 0.25, 0.3, 0.2, 0.1], [0.3, 0.4, 0.45, 0.3, 0.15]))
    lean = rng.normal(0, 0.05, 3)
    parts = [tube(_curve([(0, 0, 0), (0, 0, 0.3), lean + 0.6 * UP]), chest, _folds(rng, 0.15), 1.6)]
    parts += _head(rng, lean + 0.75 * UP, rng.uniform(0.2, 0.28))
    for side in (-1, 1):
        way = np.array([0.05, side * 0.4, 0.35]) + rng.normal(0, 0.05, 3)
        parts.append(tube(_curve([(0, 0, 0.4), way]), _profile([0.15, 0.14, 0.12], 0.2)))
    return parts + _plinth(rng, rng.uniform(0.25, 0.4))
