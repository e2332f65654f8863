"""Families of rooms: each draws surfaces at random and says where sensors may stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.placement import (
    CENTRE_THEN_MOVED,
    Draft,
    Maker,
    Station,
    furnish,
    square_m,
)
from skipnet.simulation.scenes.rooms import (
    Opening,
    OpeningKind,
    Room,
    faces_whole_room,
    floor_pieces,
    openings_in_row,
    rectangle,
    shell,
)
from skipnet.simulation.scenes.sculptures import sculpture
from skipnet.simulation.scenes.shapes import Surface, join, moved, shifted

WINDOW = OpeningKind(width_m=(1.0, 1.8), bottom_m=(0.7, 1.0), height_m=(1.1, 1.5))
DOOR = OpeningKind(width_m=(0.8, 1.2), bottom_m=(0.0, 0.0), height_m=(2.0, 2.2))
SENSOR_AREA_M = 0.8
"""Half-width of the square kept free of furniture around a sensor's station."""


def paper_room(rng: np.random.Generator) -> Draft:
    """The paper's 10 x 10 x 3 m room: three windows, two doors opposite, boxes at random."""
    room = rectangle((-5.0, -5.0), (5.0, 5.0), 3.0, thickness_m=rng.uniform(0.10, 0.15))
    openings = {
        0: openings_in_row(rng, 10.0, 3, WINDOW),
        2: openings_in_row(rng, 10.0, 2, DOOR),
    }
    return _furnished(rng, room, openings, _boxes(rng))


def closed(rng: np.random.Generator) -> Draft:
    """A room without any opening, 6 to 11 m wide, boxes at random."""
    half_m = rng.uniform(3.0, 5.5, 2)
    room = rectangle(-half_m, half_m, rng.uniform(2.4, 3.6), thickness_m=0.12)
    return _furnished(rng, room, {}, _boxes(rng))


def oblique(rng: np.random.Generator) -> Draft:
    """A floor plan of 5 to 7 oblique walls; tables, shelves and boxes turned and tipped freely."""
    room = _random_polygon(rng)
    kinds: list[Maker] = [furniture.plain_box, furniture.table, furniture.shelf]
    kinds += [furniture.turned_stack, furniture.tilted_box]
    makers = kinds + [kinds[k] for k in rng.integers(len(kinds), size=rng.integers(3, 7))]
    return _furnished(rng, room, _random_openings(rng, room), makers, turned_freely=True)


def curved(rng: np.random.Generator) -> Draft:
    """A room with round columns, drums, pipes and spheres among its boxes."""
    half_m = rng.uniform(3.5, 5.5, 2)
    room = rectangle(-half_m, half_m, rng.uniform(2.6, 3.8), thickness_m=rng.uniform(0.10, 0.15))
    column = partial(furniture.column, height_m=room.height_m)
    kinds: list[Maker] = [
        column,
        furniture.drum,
        furniture.pipe,
        furniture.ball,
        furniture.ball_on_drum,
    ]
    more = [*kinds, furniture.plain_box, furniture.table]
    makers = kinds + [more[k] for k in rng.integers(len(more), size=rng.integers(3, 8))]
    return _furnished(rng, room, _random_openings(rng, room), makers, turned_freely=True)


def doorway(rng: np.random.Generator) -> Draft:
    """Two rooms that share a wall with one door; the first scan is in one, the second in the other.

    Each sensor sees only the part of the other room that the door frames.
    """
    thickness_m, height_m = rng.uniform(0.12, 0.20), rng.uniform(2.5, 3.2)
    (depth_a, depth_b), (left_a, left_b) = rng.uniform(4.0, 7.0, 2), rng.uniform(2.0, 4.0, 2)
    right_a, right_b = rng.uniform(2.0, 4.0, 2)
    # The door's middle is the origin; the shared wall fills 0 <= x <= thickness.
    first = rectangle((-depth_a, -right_a), (0.0, left_a), height_m, thickness_m)
    second = rectangle(
        (thickness_m, -right_b), (thickness_m + depth_b, left_b), height_m, thickness_m
    )
    width_m, door_height_m = rng.uniform(0.8, 1.1), rng.uniform(2.0, 2.2)
    door = {1: [Opening(right_a - width_m / 2, width_m, 0.0, door_height_m)]}
    # Walls run counter-clockwise: from the second room the door is measured from its left end.
    door_from_behind = {3: [Opening(left_b - width_m / 2, width_m, 0.0, door_height_m)]}
    windows_a = {3: openings_in_row(rng, left_a + right_a, int(rng.integers(1, 3)), WINDOW)}
    windows_b = {1: openings_in_row(rng, left_b + right_b, int(rng.integers(1, 3)), WINDOW)}
    floor = join(floor_pieces(first, door) + floor_pieces(second, {}))
    walls = shell(first, door | windows_a) + shell(second, windows_b | door_from_behind, bare=(3,))
    away_m = rng.uniform(1.2, 2.0)
    stations = ((-away_m, 0.0), (thickness_m + away_m, 0.0))
    free = [square_m(np.array(s), away_m) for s in stations]
    pieces = furnish(rng, first.corners_m, _boxes(rng, few=True), free, turned_freely=True)
    pieces += furnish(rng, second.corners_m, _boxes(rng, few=True), free, turned_freely=True)
    rings = tuple(Station(centre_m, 0.0, SENSOR_AREA_M) for centre_m in stations)
    return Draft([floor, *walls, *pieces], rings)


def corridor(rng: np.random.Generator) -> Draft:
    """A long bare corridor whose ends are out of the scanners' range.

    Nothing tells where along it, or facing which way, a scan was taken: no method can register
    such a pair, and the honest answer is "ambiguous".
    """
    half_m = np.array([rng.uniform(36.0, 45.0), rng.uniform(0.9, 1.6)])
    room = rectangle(-half_m, half_m, rng.uniform(2.3, 3.0), thickness_m=0.12)
    surfaces = [join(floor_pieces(room, {})), *shell(room, {})]
    return Draft(surfaces, CENTRE_THEN_MOVED)


def symmetric(rng: np.random.Generator) -> Draft:
    """A closed square room that looks the same after a quarter turn, furniture included.

    Four poses explain every pair equally well: the honest answer is "ambiguous".
    """
    half_m = rng.uniform(4.0, 5.5)
    room = rectangle((-half_m, -half_m), (half_m, half_m), rng.uniform(2.4, 3.4), thickness_m=0.12)
    quarter_m = rectangle((0.0, 0.0), (half_m, half_m), room.height_m, 0.0).corners_m
    free = [square_m(np.zeros(2), SENSOR_AREA_M)]
    pieces = furnish(rng, quarter_m, [furniture.plain_box] * rng.integers(2, 4), free)
    surfaces = [join(floor_pieces(room, {})), *shell(room, {})]
    for turns in range(4):
        turn = rotation_from_vector(np.array([0.0, 0.0, turns * np.pi / 2]))
        surfaces += moved(pieces, make_transform(turn, np.zeros(3)))
    return Draft(surfaces, CENTRE_THEN_MOVED)


def gallery(rng: np.random.Generator) -> Draft:
    """An oblique room with sculptures as large as people, tables and shelves."""
    room = _random_polygon(rng)
    kinds: list[Maker] = [furniture.table, furniture.shelf, furniture.turned_stack]
    makers = [_statue] * rng.integers(2, 5) + [kinds[k] for k in rng.integers(3, size=4)]
    return _furnished(rng, room, _random_openings(rng, room), makers, turned_freely=True)


def _statue(rng: np.random.Generator) -> list[Surface]:
    """A sculpture that stands on the floor."""
    parts, scale = sculpture(rng), rng.uniform(0.5, 1.7)
    lowest_m = min(part.vertices_m[:, 2].min() for part in parts)
    parts = shifted(parts, (0, 0, -lowest_m))
    return [replace(part, vertices_m=scale * part.vertices_m) for part in parts]


def _furnished(
    rng: np.random.Generator,
    room: Room,
    openings: Mapping[int, Sequence[Opening]],
    makers: Sequence[Maker],
    turned_freely: bool = False,
) -> Draft:
    free = [square_m(np.zeros(2), SENSOR_AREA_M)]
    pieces = furnish(rng, room.corners_m, makers, free, turned_freely)
    floor = join(floor_pieces(room, openings))
    return Draft([floor, *shell(room, openings), *pieces], CENTRE_THEN_MOVED)


def _boxes(rng: np.random.Generator, few: bool = False) -> list[Maker]:
    least = 2 if few else 6
    makers: list[Maker] = [furniture.plain_box] * int(rng.integers(least, 2 * least))
    return makers + [furniture.stack] * int(rng.integers(1, 3))


def _random_polygon(rng: np.random.Generator) -> Room:
    """A room of 5 to 7 corners, all visible from the origin, drawn until no wall is under 2 m."""
    count = int(rng.integers(5, 8))
    while True:
        angles_rad = 2 * np.pi * (np.arange(count) + rng.uniform(-0.25, 0.25, count)) / count
        radius_m = rng.uniform(4.0, 6.5, count)
        corners_m = radius_m[:, None] * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
        sides_m = np.roll(corners_m, -1, axis=0) - corners_m
        if np.linalg.norm(sides_m, axis=1).min() >= 2.0:
            break
    return Room(corners_m, rng.uniform(2.4, 3.8), rng.uniform(0.10, 0.15), kernel_m=np.zeros(2))


def _random_openings(rng: np.random.Generator, room: Room) -> dict[int, list[Opening]]:
    """A door in one wall and windows in two others, out of those that have the room on one side."""
    outer = [k for k in range(len(room.corners_m)) if faces_whole_room(room, k)]
    door_wall, *window_walls = rng.permutation(outer)[:3].tolist()
    openings = {door_wall: openings_in_row(rng, room.walls[door_wall].length_m, 1, DOOR)}
    for k in window_walls:
        length_m = room.walls[k].length_m
        count = int(rng.integers(1, 2 + length_m // 4))
        openings[k] = openings_in_row(rng, length_m, count, WINDOW)
    return openings
