"""Floors of office buildings: a corridor, alike rooms on both sides, doors between some of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.placement import Draft, Maker, Station, furnish, square_m
from skipnet.simulation.scenes.rooms import (
    Opening,
    Room,
    floor_pieces,
    rectangle,
    shell,
)
from skipnet.simulation.scenes.shapes import Surface, join, moved
from skipnet.types import FloatArray

ROOMS_PER_SCAN = 0.6
"""The other scans are taken in the corridor."""
PASSAGE_SHARE = 0.3
"""So many neighbouring rooms have a door between them."""
MAKERS: list[Maker] = [furniture.table, furniture.shelf, furniture.plain_box, furniture.stack]


@dataclass(frozen=True)
class Plan:
    """The measures that all rooms of a floor share."""

    width_m: float
    """Of a room, along the corridor."""
    depth_m: float
    height_m: float
    wall_m: float
    """Thickness of every wall."""
    corridor_m: float
    """Width of the corridor."""
    door: Opening
    """To the corridor, measured along a room's own wall."""
    window: Opening
    """In the wall opposite."""
    passage: Opening
    """To the next room, where there is one."""

    def room(self, column: int, is_north: bool) -> Room:
        """The room at a place along the corridor, on either side of it."""
        low_x_m = column * (self.width_m + self.wall_m)
        low_y_m = self.corridor_m + self.wall_m if is_north else -self.wall_m - self.depth_m
        low_m = np.array([low_x_m, low_y_m])
        return rectangle(low_m, low_m + [self.width_m, self.depth_m], self.height_m, self.wall_m)


def office_floor(
    rng: np.random.Generator, scans: int, twins: bool = False, spread: float = 1.0
) -> Draft:
    """A floor whose stations cover it: one scan in every room, the others along the corridor.

    Args:
        rng: draws measures, passages and furniture.
        scans: how many scans it is meant for; the floor grows with them.
        twins: furnish two rooms exactly alike.
        spread: columns of rooms per column that is scanned; more makes a long corridor.
    """
    rooms = max(2, 2 * round(ROOMS_PER_SCAN * scans / 2))
    scanned = rooms // 2
    columns = max(scanned, round(spread * scanned))
    plan = _draw_plan(rng)
    passages = rng.random((2, columns - 1)) < PASSAGE_SHARE
    surfaces = _corridor(rng, plan, columns)
    seeds = rng.integers(1 << 32, size=(2, columns))
    if twins:
        seeds[1, scanned // 2] = seeds[0, 0]
    for is_north in (False, True):
        side = passages[int(is_north)]
        for column in range(columns):
            before = column > 0 and bool(side[column - 1])
            after = column < columns - 1 and bool(side[column])
            surfaces += _room(plan, column, is_north, before, after)
            surfaces += _furniture(plan, column, is_north, int(seeds[int(is_north), column]))
    steps = np.linspace(0, columns - 1, scanned).round().astype(int)
    return Draft(surfaces, _stations(plan, steps.tolist(), columns, scans - rooms))


def _draw_plan(rng: np.random.Generator) -> Plan:
    width_m, depth_m, height_m = rng.uniform([3.6, 4.0, 2.5], [4.6, 5.5, 3.0])
    door_m, window_m, passage_m = rng.uniform([0.9, 1.4, 0.9], [1.1, 2.0, 1.1])
    return Plan(
        width_m=width_m,
        depth_m=depth_m,
        height_m=height_m,
        wall_m=rng.uniform(0.12, 0.2),
        corridor_m=rng.uniform(1.8, 2.4),
        door=Opening(rng.uniform(0.4, 0.35 * width_m), door_m, 0.0, 2.1),
        window=Opening(rng.uniform(0.5, width_m - window_m - 0.5), window_m, 0.9, 1.3),
        passage=Opening(rng.uniform(0.6, depth_m - passage_m - 0.6), passage_m, 0.0, 2.1),
    )


def _corridor(rng: np.random.Generator, plan: Plan, columns: int) -> list[Surface]:
    """Floor, ceiling and walls of the corridor with the doors' reveals, one end open by a door."""
    length_m = columns * (plan.width_m + plan.wall_m) - plan.wall_m
    corridor = rectangle((0.0, 0.0), (length_m, plan.corridor_m), plan.height_m, plan.wall_m)
    step_m = plan.width_m + plan.wall_m
    from_left_m = [column * step_m + plan.door.start_m for column in range(columns)]
    from_right_m = [column * step_m + plan.width_m - plan.door.start_m for column in range(columns)]
    exit_m = Opening((plan.corridor_m - 1.0) / 2, 1.0, 0.0, 2.1)
    openings = {
        0: [_door_at(plan, right_m - plan.door.width_m) for right_m in from_right_m],
        2: [_door_at(plan, length_m - left_m - plan.door.width_m) for left_m in from_left_m],
        1: [exit_m],
    }
    pieces = [join(floor_pieces(corridor, openings)), *shell(corridor, openings)]
    cupboards: Sequence[Maker] = [furniture.shelf] * max(1, columns // 2)
    doors_m = [square_m(np.array([x_m, 0.5 * plan.corridor_m]), 0.9) for x_m in from_left_m]
    return pieces + furnish(rng, corridor.corners_m, cupboards, doors_m)


def _door_at(plan: Plan, start_m: float) -> Opening:
    return Opening(start_m, plan.door.width_m, 0.0, plan.door.height_m)


def _room(plan: Plan, column: int, is_north: bool, before: bool, after: bool) -> list[Surface]:
    """Floor, ceiling and walls of a room; the corridor and the room before bring shared reveals."""
    room = plan.room(column, is_north)
    to_corridor, outside = (0, 2) if is_north else (2, 0)
    openings: dict[int, list[Opening]] = {to_corridor: [plan.door], outside: [plan.window]}
    back = Opening(
        plan.depth_m - plan.passage.start_m - plan.passage.width_m,
        plan.passage.width_m,
        0.0,
        plan.passage.height_m,
    )
    passage = {1: [plan.passage]} if after else {}
    if before:
        openings[3] = [back]
    floor = join(floor_pieces(room, passage))
    return [floor, *shell(room, openings | passage, bare=(to_corridor, 3))]


def _furniture(plan: Plan, column: int, is_north: bool, seed: int) -> list[Surface]:
    """Three to six pieces, apart from the doors and the middle of the room."""
    rng = np.random.default_rng(seed)
    half_m = np.array([plan.width_m, plan.depth_m]) / 2
    outline_m = rectangle(-half_m, half_m, plan.height_m, plan.wall_m).corners_m
    # A southern room's frame: its door lies at +y; a northern one is turned by half a turn.
    door_x_m = half_m[0] - plan.door.start_m - plan.door.width_m / 2
    free_m = [
        square_m(np.zeros(2), 0.7),
        square_m(np.array([door_x_m, half_m[1] - 0.6]), 0.6),
        *(square_m(np.array([side * (half_m[0] - 0.4), 0.0]), 0.6) for side in (-1, 1)),
    ]
    makers = [MAKERS[k] for k in rng.integers(len(MAKERS), size=rng.integers(3, 7))]
    pieces = furnish(rng, outline_m, makers, free_m)
    turn = rotation_from_vector(np.array([0.0, 0.0, np.pi * is_north]))
    return moved(pieces, make_transform(turn, np.append(_centre_m(plan, column, is_north), 0.0)))


def _centre_m(plan: Plan, column: int, is_north: bool) -> FloatArray:
    centre_m: FloatArray = plan.room(column, is_north).corners_m.mean(axis=0)
    return centre_m


def _stations(
    plan: Plan, scanned: Sequence[int], columns: int, in_corridor: int
) -> tuple[Station, ...]:
    """One in every scanned room, the others evenly along the corridor."""
    rooms = [_centre_m(plan, column, north) for column in scanned for north in (False, True)]
    length_m = columns * (plan.width_m + plan.wall_m)
    along_m = (np.arange(in_corridor) + 0.5) * length_m / max(in_corridor, 1)
    corridor = [np.array([x_m, plan.corridor_m / 2]) for x_m in along_m]
    return tuple(
        [Station((float(x), float(y)), 0.0, 0.5) for x, y in rooms]
        + [Station((float(x), float(y)), 0.0, 1.5) for x, y in corridor]
    )
