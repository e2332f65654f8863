"""Small rooms lined with things: worktops and cupboards along the walls, loaded to the full."""

from __future__ import annotations

from functools import partial

import numpy as np

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.organic import loaded_table, lump, small_thing
from skipnet.simulation.scenes.placement import CENTRE_THEN_MOVED, Draft, Maker, furnish, square_m
from skipnet.simulation.scenes.rooms import Wall, floor_pieces, rectangle, shell
from skipnet.simulation.scenes.shapes import Surface, box, join, moved, shifted
from skipnet.types import FloatArray

GAP_M = 0.01
"""Between neighbours along a wall, and between them and the wall: no two faces share a plane."""


def kitchen(rng: np.random.Generator) -> Draft:
    """A room 4 to 6 m wide whose walls hardly show behind what stands and hangs there."""
    half_m = rng.uniform(2.0, 3.0, 2)
    room = rectangle(-half_m, half_m, rng.uniform(2.3, 2.9), thickness_m=0.12)
    lined = [surface for wall in room.walls for surface in _line(rng, wall)]
    kinds: list[Maker] = [loaded_table, furniture.ball_on_drum, furniture.turned_stack]
    kinds += [partial(lump, radius_m=(0.15, 0.4))]
    makers = [kinds[k] for k in rng.integers(len(kinds), size=rng.integers(2, 6))]
    inner_m = rectangle(-half_m + 0.8, half_m - 0.8, 1.0, 0.0).corners_m
    pieces = furnish(rng, inner_m, makers, [square_m(np.zeros(2), 0.6)], turned_freely=True)
    surfaces = [join(floor_pieces(room, {})), *shell(room, {})]
    return Draft(surfaces + lined + pieces, CENTRE_THEN_MOVED)


def _line(rng: np.random.Generator, wall: Wall) -> list[Surface]:
    """Cupboards of any height side by side, small things on the low ones, boxes hung above."""
    surfaces: list[Surface] = []
    # The corners stay free, where two walls' rows would meet.
    place_m, end_m = 0.8, wall.length_m - 0.8
    while place_m < end_m:
        width_m = min(rng.uniform(0.4, 1.2), end_m - place_m)
        if width_m < 0.3:
            break
        tall = rng.random() < 0.25
        depth_m, height_m = rng.uniform(0.35, 0.7), rng.uniform(*((1.4, 2.1) if tall else (0.4, 1)))
        piece = box(np.array([width_m - GAP_M, depth_m, height_m]), hidden=("bottom",))
        if not tall:
            reach_m = np.array([width_m, depth_m]) / 2 - 0.12
            for _ in range(rng.integers(1, 5)):
                piece += shifted(small_thing(rng), (*rng.uniform(-reach_m, reach_m), height_m))
        surfaces += _against(wall, piece, place_m + width_m / 2, depth_m / 2 + GAP_M, 0.0)
        if not tall and rng.random() < 0.6:
            hung = rng.uniform([0.2, 0.05, 0.2], [width_m, 0.35, 0.7])
            at_m = place_m + width_m / 2
            surfaces += _against(wall, box(hung), at_m, hung[1] / 2 + GAP_M, rng.uniform(1.3, 1.6))
        place_m += width_m + (rng.uniform(0.2, 0.8) if rng.random() < 0.3 else 0.0)
    return surfaces


def _against(
    wall: Wall, piece: list[Surface], along_m: float, off_m: float, height_m: float
) -> list[Surface]:
    """The piece, its x along the wall, at a place along it, off it and over the floor."""
    along: FloatArray = wall.along[:2]
    turn = rotation_from_vector(np.array([0, 0, np.arctan2(along[1], along[0])]))
    inwards = np.array([-along[1], along[0]])
    place_m = wall.start_m + along_m * along + off_m * inwards
    return moved(piece, make_transform(turn, np.append(place_m, height_m)))
