"""Rooms: floor, ceiling and walls with real openings, whose reveals show the wall's thickness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.simulation.shapes import Surface, convex_polygon, facing, star_polygon
from skipnet.types import FloatArray


@dataclass(frozen=True)
class Opening:
    """A rectangular hole in a wall: a door when it reaches the floor, else a window."""

    start_m: float
    """Distance along the wall from its first corner to the hole."""
    width_m: float
    bottom_m: float
    """Height of the sill; 0 for a door."""
    height_m: float

    @property
    def is_door(self) -> bool:
        """True when nothing stands below the hole."""
        return self.bottom_m == 0


@dataclass(frozen=True)
class Wall:
    """A vertical wall from ``start_m`` to ``end_m`` (2,), free space on the left of that way."""

    start_m: FloatArray
    end_m: FloatArray
    height_m: float

    @property
    def length_m(self) -> float:
        """Horizontal length."""
        return float(np.linalg.norm(self.end_m - self.start_m))

    @property
    def along(self) -> FloatArray:
        """(3,) unit vector from start to end."""
        return np.append((self.end_m - self.start_m) / self.length_m, 0.0)

    @property
    def inward(self) -> FloatArray:
        """(3,) unit normal towards free space."""
        return np.cross([0.0, 0.0, 1.0], self.along)

    def at(self, along_m: FloatArray, up_m: FloatArray, depth_m: FloatArray | float = 0.0) -> FloatArray:
        """(..., 3) points at a distance along the wall, a height, and a depth behind its face."""
        base = np.append(self.start_m, 0.0)
        return (
            base
            + np.multiply.outer(np.asarray(along_m, dtype=np.float64), self.along)
            + np.multiply.outer(np.asarray(up_m, dtype=np.float64), [0.0, 0.0, 1.0])
            - np.multiply.outer(np.asarray(depth_m, dtype=np.float64), self.inward)
        )


def wall_face(wall: Wall, openings: Sequence[Opening] = ()) -> Surface:
    """The wall's face with its openings cut out, as one flat surface."""
    along_m = np.unique([0, wall.length_m] + [e for o in openings for e in _span(o)])
    up_m = np.unique([0, wall.height_m] + [e for o in openings for e in _rise(o)])
    middle_along_m = (along_m[:-1, None] + along_m[1:, None]) / 2
    middle_up_m = (up_m[None, :-1] + up_m[None, 1:]) / 2
    solid = np.ones((len(along_m) - 1, len(up_m) - 1), dtype=bool)
    for opening in openings:
        inside_along = np.abs(middle_along_m - np.mean(_span(opening))) < opening.width_m / 2
        inside_up = np.abs(middle_up_m - np.mean(_rise(opening))) < opening.height_m / 2
        solid &= ~(inside_along & inside_up)
    column, row = np.nonzero(solid)
    width = len(up_m)
    corner = column * width + row
    quads = np.column_stack([corner, corner + 1, corner + width + 1, corner + width])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices_m = wall.at(*(grid.ravel() for grid in np.meshgrid(along_m, up_m, indexing="ij")))
    return Surface(vertices_m, triangles)


def reveals(wall: Wall, opening: Opening, thickness_m: float) -> list[Surface]:
    """The faces inside an opening: two jambs, the lintel, and a window's sill."""
    (left, right), (bottom, top) = _span(opening), _rise(opening)
    depth = [0, 0, thickness_m, thickness_m]
    up = np.array([0.0, 0.0, 1.0])
    faces = [
        facing(convex_polygon(wall.at([left] * 4, [bottom, top, top, bottom], depth)), wall.along),
        facing(convex_polygon(wall.at([right] * 4, [bottom, top, top, bottom], depth)), -wall.along),
        facing(convex_polygon(wall.at([left, right, right, left], [top] * 4, depth)), -up),
    ]
    if not opening.is_door:
        sill = wall.at([left, right, right, left], [bottom] * 4, depth)
        faces.append(facing(convex_polygon(sill), up))
    return faces


def threshold(wall: Wall, opening: Opening, thickness_m: float) -> Surface:
    """The piece of floor inside a door's opening; join it with the floor, it is the same plane."""
    left, right = _span(opening)
    depth = [0, 0, thickness_m, thickness_m]
    return facing(convex_polygon(wall.at([left, right, right, left], [0] * 4, depth)), (0, 0, 1))


@dataclass(frozen=True)
class Room:
    """A floor plan of vertical walls under a flat ceiling."""

    corners_m: FloatArray
    """(K, 2) counter-clockwise; wall k runs from corner k to corner k + 1."""
    height_m: float
    thickness_m: float
    """Depth of the openings' reveals."""
    kernel_m: FloatArray
    """(2,) a point that sees every corner."""

    @property
    def walls(self) -> list[Wall]:
        """The K walls in the order of their first corners."""
        ends = np.roll(self.corners_m, -1, axis=0)
        return [Wall(a, b, self.height_m) for a, b in zip(self.corners_m, ends, strict=True)]


def floor_pieces(room: Room, openings: Mapping[int, Sequence[Opening]]) -> list[Surface]:
    """The floor and the thresholds of its doors: pieces of one plane, to be joined."""
    pieces = [facing(_slab(room, 0.0), (0, 0, 1))]
    for index, wall_openings in openings.items():
        doors = [opening for opening in wall_openings if opening.is_door]
        pieces += [threshold(room.walls[index], door, room.thickness_m) for door in doors]
    return pieces


def shell(room: Room, openings: Mapping[int, Sequence[Opening]]) -> list[Surface]:
    """Ceiling, walls and reveals of a room, without the floor.

    Args:
        room: the floor plan.
        openings: wall index -> its openings. A wall with openings must have the whole room on its
            inner side, or beams that leave would meet other walls from behind.
    """
    surfaces = [facing(_slab(room, room.height_m), (0, 0, -1))]
    for index, wall in enumerate(room.walls):
        holes = openings.get(index, ())
        surfaces.append(wall_face(wall, holes))
        surfaces += [face for hole in holes for face in reveals(wall, hole, room.thickness_m)]
    return surfaces


def openings_in_row(
    rng: np.random.Generator,
    wall_length_m: float,
    count: int,
    width_m: tuple[float, float],
    bottom_m: tuple[float, float],
    height_m: tuple[float, float],
    margin_m: float = 0.3,
) -> list[Opening]:
    """``count`` equal openings, each at a random place within its own share of the wall.

    Width, sill and height are drawn once from their (low, high) ranges, as in a real row of windows.
    """
    share_m = wall_length_m / count
    width = min(rng.uniform(*width_m), share_m - 2 * margin_m)
    bottom, height = rng.uniform(*bottom_m), rng.uniform(*height_m)
    starts_m = share_m * np.arange(count) + rng.uniform(margin_m, share_m - margin_m - width, count)
    return [Opening(float(start), width, bottom, height) for start in starts_m]


def _slab(room: Room, z_m: float) -> Surface:
    corners = np.column_stack([room.corners_m, np.full(len(room.corners_m), z_m)])
    return star_polygon(corners, np.append(room.kernel_m, z_m))


def _span(opening: Opening) -> tuple[float, float]:
    return opening.start_m, opening.start_m + opening.width_m


def _rise(opening: Opening) -> tuple[float, float]:
    return opening.bottom_m, opening.bottom_m + opening.height_m
