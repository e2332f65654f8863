"""Two that are alike and not the same: one shell with other furniture, two specimens of a kind.

No rigid motion brings one onto the other, though much of one lies on the other in some poses.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skipnet.geometry import random_rotation, transform_points
from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.families import DOOR, SENSOR_AREA_M, WINDOW
from skipnet.simulation.scenes.organic import lump, small_thing
from skipnet.simulation.scenes.placement import Maker, furnish, square_m
from skipnet.simulation.scenes.rooms import floor_pieces, openings_in_row, rectangle, shell
from skipnet.simulation.scenes.shapes import shifted
from skipnet.simulation.situations.making import (
    Situation,
    Solids,
    anywhere,
    block,
    caster_of,
    drum,
    rings,
    sample,
    see,
    upright,
)
from skipnet.simulation.situations.objects import FLIPPED, boss, bracket, draw_arch, look_at_arch
from skipnet.types import FloatArray

Look = Callable[[np.random.Generator], FloatArray]
"""(N, 3) points of one more of a kind; what all have in common is fixed."""
INSIDE_RINGS = rings(600, 90, -55.0, 60.0)
HALL_REACH_M = 14.0
PART_POINTS = 16_000


def alike(kind: str, seed: int) -> Situation:
    """Number ``seed`` of a kind: two looks at two specimens, the second in any frame.

    Args:
        kind: one of `KINDS`.
        seed: of what they have in common, of what each has of its own, and of the looks.
    """
    rng = np.random.default_rng([seed, 11, list(KINDS).index(kind)])
    look = KINDS[kind](rng)
    source_m, target_m = look(rng), look(rng)
    if kind == "mirror image":
        target_m = source_m * FLIPPED + rng.normal(0, 0.05, source_m.shape)
    extent_m = float(np.linalg.norm(np.ptp(source_m, axis=0)))
    T = anywhere(rng, 0.0 if KINDS[kind] in _SEEN else extent_m)
    return Situation(kind, source_m, transform_points(T, target_m), None)


def _room(rng: np.random.Generator) -> Look:
    """One shell with all its openings; other boxes at other places."""
    boxes: list[Maker] = [furniture.plain_box, furniture.stack]
    return _inside(rng, [], boxes, (6, 12))


def _office(rng: np.random.Generator) -> Look:
    """One shell with its tables and shelves; other small things lie about on the floor."""
    large: list[Maker] = [furniture.table, furniture.table, furniture.shelf]
    return _inside(rng, large, [small_thing], (10, 20))


def _inside(
    rng: np.random.Generator, fixed: list[Maker], own: list[Maker], count: tuple[int, int]
) -> Look:
    """Terrestrial scans of a room with windows in one wall and a door in the opposite one."""
    half_m = rng.uniform(3.0, 5.0, 2)
    room = rectangle(-half_m, half_m, rng.uniform(2.4, 3.2), thickness_m=rng.uniform(0.10, 0.15))
    holes = {
        0: openings_in_row(rng, 2 * half_m[0], int(rng.integers(1, 4)), WINDOW),
        2: openings_in_row(rng, 2 * half_m[0], 1, DOOR),
    }
    free = [square_m(np.zeros(2), SENSOR_AREA_M)]
    common = furnish(rng, room.corners_m, fixed, free)
    common += [*floor_pieces(room, holes), *shell(room, holes)]

    def look(one: np.random.Generator) -> FloatArray:
        makers = [own[k] for k in one.integers(len(own), size=one.integers(*count))]
        pieces = furnish(one, room.corners_m, makers, free, turned_freely=True)
        place_m = (*one.uniform(-0.6, 0.6, 2), one.uniform(1.2, 1.7))
        return see(
            caster_of(common + pieces),
            upright(one.uniform(-3, 3), place_m),
            INSIDE_RINGS,
            0.004,
            one,
        )

    return look


def _hall(rng: np.random.Generator) -> Look:
    """One hall with its columns; other goods stand in it."""
    bay_m, high_m, bays = rng.uniform(4.5, 7.0), rng.uniform(4.0, 6.5), rng.integers(3, 6, 2)
    x_m, y_m = bay_m * bays
    common: Solids = []
    for z_m in (-0.1, high_m + 0.1):
        common += block((x_m, y_m, 0.2), (x_m / 2, y_m / 2, z_m))
    for share in (0, 1):
        common += block((x_m, 0.2, high_m), (x_m / 2, share * y_m, high_m / 2))
        common += block((0.2, y_m, high_m), (share * x_m, y_m / 2, high_m / 2))
    for i, j in np.ndindex(bays[0] - 1, bays[1] - 1):
        common += block((0.4, 0.4, high_m), ((i + 1) * bay_m, (j + 1) * bay_m, high_m / 2))

    def look(one: np.random.Generator) -> FloatArray:
        goods: Solids = []
        for _ in range(one.integers(8, 20)):
            size_m = one.uniform([0.5, 0.5, 0.4], [2.0, 1.5, 2.2])
            at_m = one.uniform(1.2, [x_m - 1.2, y_m - 1.2])
            goods += block(size_m, (*at_m, size_m[2] / 2), one.uniform(0, 3))
        at_m = (bays // 2 + 0.5) * bay_m + one.uniform(-0.8, 0.8, 2)
        T = upright(one.uniform(-3, 3), (*at_m, 2.6))  # above the goods
        return see(caster_of(common + goods), T, INSIDE_RINGS, 0.006, one, HALL_REACH_M)

    return look


def _tank(rng: np.random.Generator) -> Look:
    """One round tank; other fittings at its wall."""
    radius_m = rng.uniform(2, 6)
    common = drum(radius_m, 8.0, (0, 0, 3))
    common += block((2.4 * radius_m, 2.4 * radius_m, 0.1), (0, 0, -0.05))

    def look(one: np.random.Generator) -> FloatArray:
        fittings: Solids = []
        for _ in range(one.integers(2, 5)):
            angle, size_m = one.uniform(0, 2 * np.pi), one.uniform(0.2, 1.2, 3)
            at_m = 0.95 * radius_m * np.array([np.cos(angle), np.sin(angle)])
            fittings += block(size_m, (*at_m, one.uniform(0.3, 1.5)), angle)
        T = upright(one.uniform(-3, 3), (*one.uniform(-0.15, 0.15, 2) * radius_m, 1.5))
        return see(caster_of(common + fittings), T, INSIDE_RINGS, 0.005, one)

    return look


def _arch(rng: np.random.Generator) -> Look:
    """Arches and rings of one make; blocks of each stand a little otherwise."""
    kind = draw_arch(rng)
    return lambda one: look_at_arch(kind.specimen(one), kind.is_ring, one)


def _part(rng: np.random.Generator) -> Look:
    """Brackets of one size; all bosses are others."""
    size, bosses = np.array([120.0, *rng.uniform([50, 30], [80, 70])]), int(rng.integers(2, 5))
    return lambda one: sample(bracket(size, bosses, one), PART_POINTS, one, 0.05)


def _boss(rng: np.random.Generator) -> Look:
    """Brackets that are equal but for one of three to five bosses."""
    size = np.array([120.0, *rng.uniform([50, 30], [80, 70])])
    common = bracket(size, int(rng.integers(2, 5)), rng)
    return lambda one: sample(common + boss(size, one), PART_POINTS, one, 0.05)


def _stone(rng: np.random.Generator) -> Look:
    """Stones of one size, with other dents each."""
    radius_m = rng.uniform(0.05, 2.0)

    def look(one: np.random.Generator) -> FloatArray:
        stone = lump(one, (radius_m, radius_m))
        return sample(stone, PART_POINTS, one, 0.004 * radius_m) @ random_rotation(one).T

    return look


def _bust(rng: np.random.Generator) -> Look:
    """Busts on one body, with another head each."""
    body = lump(rng, (1.0, 1.0))
    top_m = max(float(surface.vertices_m[:, 2].max()) for surface in body)

    def look(one: np.random.Generator) -> FloatArray:
        head = shifted(lump(one, (0.5, 0.6)), (0, 0, top_m - 0.2))
        return sample(body + head, PART_POINTS, one, 0.004)

    return look


KINDS: dict[str, Callable[[np.random.Generator], Look]] = {
    "room, other furniture": _room,
    "office, other small things": _office,
    "hall, other goods": _hall,
    "tank, other fittings": _tank,
    "arch, another": _arch,
    "part, other bosses": _part,
    "part, one other boss": _boss,
    "mirror image": _part,
    "stone, another": _stone,
    "bust, another head": _bust,
}
"""Each fixes what two have in common, and gives what makes a look at one of them."""
_SEEN = (_room, _office, _hall, _tank)
"""From the origin of their frame; the others are fused or sampled."""
