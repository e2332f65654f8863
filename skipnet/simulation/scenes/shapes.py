"""Building blocks of simulated scenes: triangles wound so that normals point into free space.

Lengths are metres, z points up. A solid is a list of `Surface`; faces that nothing can ever see (a
box's bottom on the floor) are left out, so that counting the surfaces around a point counts what
meets there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from skipnet.geometry import transform_points
from skipnet.types import FloatArray, IntArray

CIRCLE_SEGMENTS = 96
"""Facets of a full turn; at a radius of 1 m the chord stays within 0.6 mm of the circle."""
BOX_FACES = ("left", "right", "front", "back", "bottom", "top")
"""Names of a box's faces: -x, +x, -y, +y, -z, +z."""


@dataclass(frozen=True)
class Surface:
    """One flat face or one smooth curved surface, as triangles."""

    vertices_m: FloatArray
    """(V, 3) float64."""
    triangles: IntArray
    """(T, 3) vertex indices, counter-clockwise seen from the free side."""
    is_curved: bool = False
    """True for a cylinder's side or a sphere, whose facets stand for one smooth surface."""


def join(surfaces: Iterable[Surface]) -> Surface:
    """Several coplanar pieces as one surface, such as a floor and the thresholds of its doors."""
    pieces = list(surfaces)
    starts = np.cumsum([0] + [len(piece.vertices_m) for piece in pieces[:-1]])
    return Surface(
        np.concatenate([piece.vertices_m for piece in pieces]),
        np.concatenate([p.triangles + start for p, start in zip(pieces, starts, strict=True)]),
        pieces[0].is_curved,
    )


def moved(surfaces: Iterable[Surface], T_world_local: FloatArray) -> list[Surface]:
    """The surfaces after the (4, 4) rigid motion ``T_world_local``."""
    return [replace(s, vertices_m=transform_points(T_world_local, s.vertices_m)) for s in surfaces]


def shifted(surfaces: Iterable[Surface], offset_m: FloatArray | tuple[float, ...]) -> list[Surface]:
    """The surfaces after a translation by the (3,) ``offset_m``."""
    return [replace(s, vertices_m=s.vertices_m + np.asarray(offset_m)) for s in surfaces]


def triangle_normals(vertices_m: FloatArray, triangles: IntArray) -> FloatArray:
    """(T, 3) unit normals by the right-hand rule: they point to the free side."""
    a, b, c = np.moveaxis(vertices_m[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def facing(surface: Surface, direction: FloatArray | tuple[float, ...]) -> Surface:
    """The flat surface wound so that its normal has a positive part along the (3,) direction."""
    normal = triangle_normals(surface.vertices_m, surface.triangles[:1])[0]
    if normal @ np.asarray(direction, dtype=np.float64) > 0:
        return surface
    return replace(surface, triangles=surface.triangles[:, ::-1])


def convex_polygon(corners_m: FloatArray) -> Surface:
    """A flat convex polygon from its (K, 3) corners in order."""
    second = np.arange(1, len(corners_m) - 1)
    triangles = np.column_stack([np.zeros_like(second), second, second + 1])
    return Surface(np.asarray(corners_m, dtype=np.float64), triangles)


def star_polygon(corners_m: FloatArray, kernel_m: FloatArray) -> Surface:
    """A flat polygon from its (K, 3) corners, all visible from the point ``kernel_m`` (3,)."""
    ring = np.arange(len(corners_m))
    triangles = np.column_stack([np.full_like(ring, len(ring)), ring, np.roll(ring, -1)])
    return Surface(np.vstack([corners_m, kernel_m]), triangles)


def box(size_m: FloatArray, hidden: tuple[str, ...] = ()) -> list[Surface]:
    """An axis-aligned box standing on z = 0, centred in x and y.

    Args:
        size_m: (3,) extents.
        hidden: names out of `BOX_FACES` of faces to leave out because something covers them.
    """
    upper = np.array([size_m[0] / 2, size_m[1] / 2, size_m[2]])
    lower = np.array([-upper[0], -upper[1], 0.0])
    faces = []
    for index, name in enumerate(BOX_FACES):
        if name in hidden:
            continue
        axis, outward = index // 2, index % 2
        corners = np.empty((4, 3))
        corners[:, axis] = (lower, upper)[outward][axis]
        for other, pattern in zip(
            [a for a in range(3) if a != axis], ([0, 1, 1, 0], [0, 0, 1, 1]), strict=True
        ):
            corners[:, other] = np.where(pattern, upper[other], lower[other])
        direction = np.zeros(3)
        direction[axis] = 2 * outward - 1
        faces.append(facing(convex_polygon(corners), direction))
    return faces


def cylinder(radius_m: float, height_m: float, hidden: tuple[str, ...] = ()) -> list[Surface]:
    """An upright cylinder standing on z = 0: side, then "bottom" and "top" discs unless hidden."""
    angles = np.linspace(0, 2 * np.pi, CIRCLE_SEGMENTS, endpoint=False)
    circle_m = np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), 0 * angles])
    vertices_m = np.vstack([circle_m, circle_m + [0, 0, height_m]])
    surfaces = [Surface(vertices_m, _band(2), is_curved=True)]
    if "bottom" not in hidden:
        surfaces.append(facing(convex_polygon(circle_m), (0, 0, -1)))
    if "top" not in hidden:
        surfaces.append(facing(convex_polygon(circle_m + [0, 0, height_m]), (0, 0, 1)))
    return surfaces


def sphere(radius_m: float, segments: int = CIRCLE_SEGMENTS) -> list[Surface]:
    """A sphere resting on z = 0, from rings of ``segments`` vertices, an even number."""
    polar = np.linspace(np.pi, 0, segments // 2 + 1)[:, None]
    azimuth = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    unit = np.empty((len(polar), len(azimuth), 3))
    unit[..., 0] = np.sin(polar) * np.cos(azimuth)
    unit[..., 1] = np.sin(polar) * np.sin(azimuth)
    unit[..., 2] = np.cos(polar)
    vertices_m = radius_m * (unit.reshape(-1, 3) + [0, 0, 1])
    triangles = _band(len(polar), segments)
    # The rings at the poles are points: triangles with two corners there have no area.
    at_pole = (triangles < segments) | (triangles >= len(vertices_m) - segments)
    return [Surface(vertices_m, triangles[at_pole.sum(axis=1) < 2], is_curved=True)]


def _band(rings: int, segments: int = CIRCLE_SEGMENTS) -> IntArray:
    """Outward triangles between rings of ``segments`` vertices, the lowest ring first."""
    index = np.arange(rings * segments).reshape(rings, segments)
    east = np.roll(index, -1, axis=1)
    lower = np.stack([index[:-1], east[:-1], east[1:]], axis=-1)
    upper = np.stack([index[:-1], east[1:], index[1:]], axis=-1)
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])
