"""Kinds of pairs on which registration takes long: little shared, few lines, nothing in common."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skipnet.checks import suggestion
from skipnet.simulation.scanning.figures import turn_figure
from skipnet.simulation.scanning.glimpses import EYES, glimpse
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scanning.views import look_around
from skipnet.types import FloatArray, Pair

POINTS = 200_000
"""Of each scan of rooms; what the other kinds have follows from their scanners."""
FAR_TURN_RAD = float(np.deg2rad(40.0))
"""Between what two cameras of a narrow view look at: they share a third or so."""
FIGURE_TURN_RAD = float(np.deg2rad(70.0))
WIDE = float(np.deg2rad(2.0)), 0.3
"""Radians and metres of success outdoors and where little is shared ..."""
FIGURE = float(np.deg2rad(5.0)), 0.005
"""... and of figures."""


def hard_pair(kind: str, seed: int) -> Pair:
    """A pair of one of ``HARD_KINDS``; of one that shares nothing the overlap is 0, and no pose is
    right.

    Raises:
        ValueError: unknown kind; the message lists what exists.
    """
    check_kinds([kind])
    return HARD_KINDS[kind](seed)


def check_kinds(kinds: list[str]) -> None:
    """Refuse what is not one of ``HARD_KINDS``."""
    for kind in kinds:
        if kind not in HARD_KINDS:
            raise ValueError(f"unknown kind of pair {kind!r}{suggestion(kind, tuple(HARD_KINDS))}")


def _rings(seed: int) -> Pair:
    return simulate_pair("oblique", seed, "rings").pair


def _unlike(first: Pair, second: Pair) -> Pair:
    """The first one's source and the second one's target."""
    return replace(
        second,
        name=f"{first.name}, {second.name}",
        source_m=first.source_m,
        source_viewpoint_m=first.source_viewpoint_m,
        overlap=0.0,
    )


def _negative(seed: int) -> Pair:
    pairs = [simulate_pair(family, seed, points=POINTS).pair for family in ("clutter", "oblique")]
    return _unlike(*pairs)


def _rings_negative(seed: int) -> Pair:
    return _unlike(simulate_pair("clutter", seed, "rings").pair, _rings(seed))


def _low_overlap(seed: int) -> Pair:
    views = look_around("kitchen", seed, "camera")
    clouds_m = views.clouds_m(FAR_TURN_RAD)
    return _pair("low_overlap", seed, *clouds_m, views.T_target_source, WIDE)


def _narrow(seed: int) -> Pair:
    seen = glimpse("facade", seed, EYES["narrow_lidar"], np.random.default_rng(seed))
    return _pair("narrow", seed, *seen, WIDE)


def _object(seed: int) -> Pair:
    table = turn_figure(seed)
    clouds_m, T = table.clouds_m(FIGURE_TURN_RAD), table.T_target_source(FIGURE_TURN_RAD)
    return _pair("object", seed, *clouds_m, T, FIGURE)


def _pair(
    kind: str,
    seed: int,
    source_m: FloatArray,
    target_m: FloatArray,
    T_target_source: FloatArray,
    right: tuple[float, float],
) -> Pair:
    return Pair(
        name=f"{kind}_{seed}",
        set_name=kind,
        source_m=source_m,
        target_m=target_m,
        T_target_source=T_target_source,
        success_rotation_rad=right[0],
        success_translation_m=right[1],
    )


HARD_KINDS: dict[str, Callable[[int], Pair]] = {
    "rings": _rings,
    "negative": _negative,
    "rings_negative": _rings_negative,
    "low_overlap": _low_overlap,
    "narrow": _narrow,
    "object": _object,
}
"""Sixteen rings in a room; two rooms; rings in two rooms; cameras that look apart; a narrow LiDAR
outdoors; a figure on a turntable."""
