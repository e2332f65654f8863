"""Rooms: floor, ceiling and walls with real openings, whose reveals show the wall's thickness."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skipnet.simulation.scenes.shapes import Surface, convex_polygon, facing, star_polygon
from skipnet.types import FloatArray

MARGIN_M = 0.3
"""Least distance of an opening from the end of its share of the wall."""


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
class OpeningKind:
    """(low, high) ranges from which a row of openings is drawn."""

    width_m: tuple[float, float]
    bottom_m: tuple[float, float]
    height_m: tuple[float, float]


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

    def at(self, along_m: ArrayLike, up_m: ArrayLike, depth_m: ArrayLike = 0.0) -> FloatArray:
        """(..., 3) points at a way along the wall, a height, and a depth behind its face."""
        base = np.append(self.start_m, 0.0)
        return (
            base
            + np.multiply.outer(along_m, self.along)
            + np.multiply.outer(up_m, [0.0, 0.0, 1.0])
            - np.multiply.outer(depth_m, self.inward)
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
    across, up = [left, right, right, left], [bottom, top, top, bottom]
    faces = [
        facing(convex_polygon(wall.at([left] * 4, up, depth)), wall.along),
        facing(convex_polygon(wall.at([right] * 4, up, depth)), -wall.along),
        facing(convex_polygon(wall.at(across, [top] * 4, depth)), (0, 0, -1)),
    ]
    if not opening.is_door:
        sill = wall.at(across, [bottom] * 4, depth)
        faces.append(facing(convex_polygon(sill), (0, 0, 1)))
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


def shell(
    room: Room, openings: Mapping[int, Sequence[Opening]], bare: Container[int] = ()
) -> list[Surface]:
    """Ceiling, walls and reveals of a room, without the floor.

    Args:
        room: the floor plan.
        openings: wall index -> its openings. A wall with openings must have the whole room on its
            inner side, or beams that leave would meet other walls from behind.
        bare: walls whose openings get no reveals, because the room behind a shared wall has them.
    """
    surfaces = [facing(_slab(room, room.height_m), (0, 0, -1))]
    for index, wall in enumerate(room.walls):
        holes = openings.get(index, ())
        surfaces.append(wall_face(wall, holes))
        if index not in bare:
            surfaces += [face for hole in holes for face in reveals(wall, hole, room.thickness_m)]
    return surfaces


def faces_whole_room(room: Room, index: int) -> bool:
    """Whether the whole room lies on the inner side of a wall, as it does for a convex plan."""
    wall = room.walls[index]
    return bool(((room.corners_m - wall.start_m) @ wall.inward[:2] >= -1e-9).all())


def rectangle(low_m: ArrayLike, high_m: ArrayLike, height_m: float, thickness_m: float) -> Room:
    """A room between two corners (2,); walls 0 to 3 face +y, -x, -y and +x."""
    (x0, y0), (x1, y1) = np.asarray(low_m), np.asarray(high_m)
    corners_m = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=np.float64)
    return Room(corners_m, height_m, thickness_m, kernel_m=corners_m.mean(axis=0))


def openings_in_row(
    rng: np.random.Generator,
    wall_length_m: float,
    count: int,
    kind: OpeningKind,
) -> list[Opening]:
    """``count`` equal openings, each at a random place within its own share of the wall.

    Width, sill and height are drawn once, as in a real row; a short wall narrows its openings.
    """
    share_m = wall_length_m / count
    width = min(rng.uniform(*kind.width_m), share_m - 2 * MARGIN_M)
    bottom, height = rng.uniform(*kind.bottom_m), rng.uniform(*kind.height_m)
    slack_m = share_m - 2 * MARGIN_M - width
    starts_m = share_m * np.arange(count) + MARGIN_M + slack_m * rng.random(count)
    return [Opening(float(start), width, bottom, height) for start in starts_m]


def _slab(room: Room, z_m: float) -> Surface:
    corners = np.column_stack([room.corners_m, np.full(len(room.corners_m), z_m)])
    return star_polygon(corners, np.append(room.kernel_m, z_m))


def _span(opening: Opening) -> tuple[float, float]:
    return opening.start_m, opening.start_m + opening.width_m


def _rise(opening: Opening) -> tuple[float, float]:
    return opening.bottom_m, opening.bottom_m + opening.height_m
