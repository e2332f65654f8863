"""The families of simulated scenes: each draws surfaces and says where sensors may stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from skipnet.simulation.furniture import furnish, plain_box, square_m, stack
from skipnet.simulation.rooms import Opening, Room, floor_pieces, openings_in_row, shell
from skipnet.simulation.shapes import Surface, join
from skipnet.types import FloatArray

SENSOR_AREA_M = 0.8
"""Half-width of the square kept free of furniture around a room's first station."""
WINDOW = {"width_m": (1.0, 1.8), "bottom_m": (0.7, 1.0), "height_m": (1.1, 1.5)}
DOOR = {"width_m": (0.8, 1.2), "bottom_m": (0.0, 0.0), "height_m": (2.0, 2.2)}


@dataclass(frozen=True)
class Station:
    """A ring on the floor in which one sensor may stand."""

    centre_m: tuple[float, float]
    nearest_m: float
    farthest_m: float


@dataclass(frozen=True)
class Draft:
    """What a family draws: the surfaces, and one station per scan (further scans repeat the last)."""

    surfaces: list[Surface]
    stations: tuple[Station, ...]


CENTRE_THEN_MOVED = (Station((0.0, 0.0), 0.0, 0.0), Station((0.0, 0.0), 1.0, 3.0))
"""The paper's two stations: the room's centre, and 1 to 3 m away from it."""


def paper_room(rng: np.random.Generator) -> Draft:
    """The paper's 10 x 10 x 3 m room: three windows, two doors opposite, boxes at random."""
    room = _rectangle(10.0, 10.0, 3.0, thickness_m=rng.uniform(0.10, 0.15))
    openings = {
        0: openings_in_row(rng, 10.0, 3, **WINDOW),
        2: openings_in_row(rng, 10.0, 2, **DOOR),
    }
    return _furnished_with_boxes(rng, room, openings)


def closed(rng: np.random.Generator) -> Draft:
    """A room without any opening, 6 to 11 m wide, boxes at random."""
    width_m, depth_m = rng.uniform(6.0, 11.0, 2)
    room = _rectangle(width_m, depth_m, rng.uniform(2.4, 3.6), thickness_m=0.12)
    return _furnished_with_boxes(rng, room, {})


def _furnished_with_boxes(
    rng: np.random.Generator, room: Room, openings: dict[int, list[Opening]]
) -> Draft:
    makers = [plain_box] * rng.integers(6, 12) + [stack] * rng.integers(1, 3)
    pieces = furnish(rng, room.corners_m, makers, [square_m(np.zeros(2), SENSOR_AREA_M)])
    floor = join(floor_pieces(room, openings))
    return Draft([floor, *shell(room, openings), *pieces], CENTRE_THEN_MOVED)


def _rectangle(width_m: float, depth_m: float, height_m: float, thickness_m: float) -> Room:
    half: FloatArray = np.array([width_m, depth_m]) / 2
    corners_m = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return Room(corners_m, height_m, thickness_m, kernel_m=np.zeros(2))


FAMILY_MAKERS: dict[str, Callable[[np.random.Generator], Draft]] = {
    "paper_room": paper_room,
    "closed": closed,
}
