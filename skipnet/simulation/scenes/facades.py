"""Outdoor scenes: a row of house fronts behind a street with trees, cars and bins."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.placement import Draft, Station, furnish, square_m
from skipnet.simulation.scenes.rooms import (
    Opening,
    OpeningKind,
    Wall,
    openings_in_row,
    rectangle,
    reveals,
    threshold,
    wall_face,
)
from skipnet.simulation.scenes.shapes import Surface, box, cylinder, join, shifted, sphere

WINDOW = OpeningKind(width_m=(0.9, 1.4), bottom_m=(0.8, 1.0), height_m=(1.4, 1.8))
DOOR = OpeningKind(width_m=(1.0, 2.0), bottom_m=(0.0, 0.0), height_m=(2.2, 2.8))
HALF_STREET_M = 30.0
"""The fronts and the street reach this far to both sides of the first station."""
STREET_DEPTH_M = 26.0
WALL_THICKNESS_M = 0.25


@dataclass(frozen=True)
class House:
    """A front that faces -y, from ``left_m`` to ``right_m`` along x, at depth ``front_m``."""

    left_m: float
    right_m: float
    front_m: float
    height_m: float

    @property
    def front(self) -> Wall:
        """The front as a wall, free space towards -y."""
        start, end = (self.right_m, self.front_m), (self.left_m, self.front_m)
        return Wall(np.array(start), np.array(end), self.height_m)


def facade(rng: np.random.Generator) -> Draft:
    """A 60 m row of house fronts with windows and reveals, seen from the street."""
    houses = _row_of_houses(rng)
    openings = [_openings(rng, house) for house in houses]
    ground = [_ground(house) for house in houses]
    surfaces: list[Surface] = []
    for house, holes in zip(houses, openings, strict=True):
        surfaces.append(wall_face(house.front, holes))
        for hole in holes:
            surfaces += reveals(house.front, hole, WALL_THICKNESS_M)
        ground += [threshold(house.front, hole, WALL_THICKNESS_M) for hole in holes if hole.is_door]
    for left, right in zip(houses[:-1], houses[1:], strict=True):
        surfaces += _step(left, right)
    things = [_tree] * rng.integers(4, 9) + [_car] * rng.integers(3, 7)
    things += [furniture.plain_box, furniture.drum] * rng.integers(1, 4)
    street = rectangle((-HALF_STREET_M, -STREET_DEPTH_M), (HALF_STREET_M, 0.0), 0.0, 0.0)
    station = (0.0, -rng.uniform(11.0, 16.0))
    free = [square_m(np.array(station), 2.0)]
    pieces = furnish(rng, street.corners_m, things, free, turned_freely=True)
    stations = (Station(station, 0.0, 0.5), Station(station, 3.0, 9.0))
    return Draft([join(ground), *surfaces, *pieces], stations)


def _row_of_houses(rng: np.random.Generator) -> list[House]:
    """Houses side by side; neighbours step back or forward against each other."""
    count = int(rng.integers(4, 7))
    shares = rng.uniform(0.7, 1.3, count)
    edges_m = HALF_STREET_M * (2 * np.cumsum(np.append(0.0, shares)) / shares.sum() - 1)
    heights_m = rng.uniform(6.0, 14.0, count)
    fronts_m = rng.uniform(0.4, 1.6, count) + 1.5 * (np.arange(count) % 2)
    return [
        House(*map(float, values))
        for values in zip(edges_m[:-1], edges_m[1:], fronts_m, heights_m, strict=True)
    ]


def _openings(rng: np.random.Generator, house: House) -> list[Opening]:
    """A door and windows on the ground floor, a row of windows on each floor above."""
    storey_m = rng.uniform(2.9, 3.6)
    columns = max(2, int(house.front.length_m // rng.uniform(2.4, 3.5)))
    row = openings_in_row(rng, house.front.length_m, columns, WINDOW)
    door = openings_in_row(rng, house.front.length_m / columns, 1, DOOR)[0]
    # The door takes the first window's place on the ground floor, at either end of the front.
    holes = [door, *row[1:]]
    for storey in range(1, int(house.height_m // storey_m)):
        holes += [replace(w, bottom_m=w.bottom_m + storey * storey_m) for w in row]
    return [hole for hole in holes if hole.bottom_m + hole.height_m < house.height_m - 0.3]


def _ground(house: House) -> Surface:
    street = rectangle((house.left_m, -STREET_DEPTH_M), (house.right_m, house.front_m), 0.0, 0.0)
    corners = np.column_stack([street.corners_m, np.zeros(4)])
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def _step(left: House, right: House) -> list[Surface]:
    """The side wall between two fronts at different depths, and its inner face behind windows."""
    nearer, farther = sorted((left, right), key=lambda house: house.front_m)
    x_m = left.right_m
    towards_free = 1.0 if nearer is left else -1.0
    near_y, far_y = nearer.front_m, farther.front_m
    ends = ((x_m, near_y), (x_m, far_y)) if towards_free < 0 else ((x_m, far_y), (x_m, near_y))
    outer = Wall(np.array(ends[0]), np.array(ends[1]), nearer.height_m)
    inside_x = x_m - towards_free * WALL_THICKNESS_M
    inner = Wall(
        np.array([inside_x, ends[1][1]]), np.array([inside_x, ends[0][1]]), nearer.height_m
    )
    return [wall_face(outer), wall_face(inner)]


def _tree(rng: np.random.Generator) -> list[Surface]:
    """A trunk that ends inside a round crown."""
    trunk_m, crown_m = rng.uniform(2.0, 3.5), rng.uniform(1.0, 2.2)
    trunk = cylinder(rng.uniform(0.12, 0.3), trunk_m, hidden=("bottom", "top"))
    return trunk + shifted(sphere(crown_m), (0, 0, trunk_m - 0.4))


def _car(rng: np.random.Generator) -> list[Surface]:
    """A long box with a cabin on it."""
    length_m, width_m, height_m = rng.uniform([3.6, 1.6, 0.8], [4.6, 1.9, 1.0])
    cabin = box(np.array([0.5 * length_m, 0.85 * width_m, 0.6]), hidden=("bottom",))
    on_top = shifted(cabin, (rng.uniform(-0.1, 0.1) * length_m, 0, height_m))
    return box(np.array([length_m, width_m, height_m]), hidden=("bottom",)) + on_top
