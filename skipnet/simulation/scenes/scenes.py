"""A simulated scene: triangles that know their surface, and where sensors may stand."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skipnet.checks import suggestion
from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes import facades, families, kitchens, organic
from skipnet.simulation.scenes.placement import Draft, Station
from skipnet.simulation.scenes.raycasting import Raycaster
from skipnet.simulation.scenes.shapes import triangle_normals
from skipnet.types import BoolArray, FloatArray, IntArray

FAMILY_MAKERS: dict[str, Callable[[np.random.Generator], Draft]] = {
    "paper_room": families.paper_room,
    "oblique": families.oblique,
    "curved": families.curved,
    "doorway": families.doorway,
    "closed": families.closed,
    "facade": facades.facade,
    "terrain": organic.terrain,
    "clutter": organic.clutter,
    "kitchen": kitchens.kitchen,
    "gallery": families.gallery,
    "corridor": families.corridor,
    "symmetric": families.symmetric,
}
FAMILIES: tuple[str, ...] = tuple(FAMILY_MAKERS)
"""Names that `make_scene` knows."""
AMBIGUOUS_FAMILIES: tuple[str, ...] = ("corridor", "symmetric")
"""Families in which no two scans fix their pose: the right answer is that there are several."""
SENSOR_HEIGHT_M = (1.0, 1.8)
SENSOR_CLEARANCE_M = 0.5
"""Least distance of a placed sensor from every surface."""
PLACEMENT_TRIES = 200
PLACEMENT_ROUNDS = 20


@dataclass(frozen=True)
class Scene:
    """A scene in its world frame: metres, z up, floor at z = 0.

    Triangle normals (right-hand rule) point into free space, where sensors can be. Faces that
    nothing can see, such as a box's bottom on the floor, are absent.
    """

    family: str
    seed: int
    vertices_m: FloatArray
    """(V, 3) float64."""
    triangles: IntArray
    """(T, 3) int32."""
    surface_of_triangle: IntArray
    """(T,) int32: the flat face or smooth surface; a wall with its holes is one surface."""
    surface_is_curved: BoolArray
    """(S,) True for smooth curved surfaces such as a cylinder's side."""
    stations: tuple[Station, ...]
    """Where sensors may stand: one entry per scan; further scans repeat the last."""

    @property
    def triangle_normals(self) -> FloatArray:
        """(T, 3) unit normals into free space."""
        return triangle_normals(self.vertices_m, self.triangles)

    @cached_property
    def raycaster(self) -> Raycaster:
        """Holds the scene's triangles; made once, building it can take as long as a scan."""
        return Raycaster(self.vertices_m, self.triangles)


def check_families(families: Iterable[str]) -> None:
    """Refuse what is no family, before anything is simulated.

    Raises:
        ValueError: one is not among `FAMILIES`.
    """
    for family in families:
        if family not in FAMILY_MAKERS:
            raise ValueError(f"unknown scene family {family!r}{suggestion(family, FAMILIES)}")


def make_scene(family: str, seed: int) -> Scene:
    """Draw the scene number ``seed`` of a family; the same arguments give the same bits.

    Raises:
        ValueError: the family is not one of `FAMILIES`, or the seed is negative.
    """
    check_families([family])
    if seed < 0:
        raise ValueError(f"seed is {seed}; expected an integer of 0 or more")
    return assemble(family, seed, FAMILY_MAKERS[family](np.random.default_rng(seed)))


def assemble(family: str, seed: int, draft: Draft) -> Scene:
    """The scene of a draft: its surfaces' triangles in one array."""
    counts = [len(surface.vertices_m) for surface in draft.surfaces]
    starts = np.cumsum([0, *counts[:-1]])
    triangles = [s.triangles + start for s, start in zip(draft.surfaces, starts, strict=True)]
    return Scene(
        family=family,
        seed=seed,
        vertices_m=np.concatenate([surface.vertices_m for surface in draft.surfaces]),
        triangles=np.concatenate(triangles).astype(np.int32),
        surface_of_triangle=np.repeat(
            np.arange(len(triangles), dtype=np.int32), [len(part) for part in triangles]
        ),
        surface_is_curved=np.array([surface.is_curved for surface in draft.surfaces]),
        stations=draft.stations,
    )


def place_sensors(scene: Scene, count: int, seed: int) -> FloatArray:
    """Poses ``T_world_sensor`` (count, 4, 4) of upright sensors in free space.

    Sensor k stands in station k at 1.0 to 1.8 m height, 0.5 m or more from every surface. The
    first keeps the world's axes, the others are turned about z by any angle.

    Raises:
        ValueError: no free place was found in a station.
    """
    place_rng, turn_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    yaws_rad = np.append(0.0, turn_rng.uniform(0, 2 * np.pi, count - 1))
    stations = [scene.stations[min(k, len(scene.stations) - 1)] for k in range(count)]
    places_m = [_free_place(scene, station, place_rng) for station in stations]
    rotations = np.stack([rotation_from_vector(np.array([0, 0, yaw])) for yaw in yaws_rad])
    return make_transform(rotations, np.stack(places_m))


def is_free(scene: Scene, positions_m: FloatArray) -> BoolArray:
    """Whether sensors at (N, 3) world positions stand free over the floor, with clearance."""
    caster = scene.raycaster
    clear = caster.distances_m(positions_m) >= SENSOR_CLEARANCE_M
    up = np.broadcast_to([0.0, 0.0, 1.0], positions_m.shape)
    above, below = caster.cast(positions_m, up), caster.cast(positions_m, -up)
    # Furniture has no bottom face: from inside, the first face overhead is met from behind.
    inside_furniture = above.normals[:, 2] > 0
    over_floor = np.abs(below.distances - positions_m[:, 2]) < 1e-3
    return clear & over_floor & ~inside_furniture


def _free_place(scene: Scene, station: Station, rng: np.random.Generator) -> FloatArray:
    angle_rad = rng.uniform(0, 2 * np.pi, PLACEMENT_TRIES)
    radius_m = rng.uniform(station.nearest_m, station.farthest_m, PLACEMENT_TRIES)
    height_m = rng.uniform(*SENSOR_HEIGHT_M, PLACEMENT_TRIES)
    offset_m = radius_m * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    positions_m = np.column_stack([*(np.array(station.centre_m)[:, None] + offset_m), height_m])
    for some_m in np.array_split(positions_m, PLACEMENT_ROUNDS):  # the first few will mostly do
        free = is_free(scene, some_m)
        if free.any():
            return some_m[np.argmax(free)]
    raise ValueError(
        f"scene {scene.family!r} seed {scene.seed}: no free place for a sensor near "
        f"{station.centre_m}; choose another seed"
    )
