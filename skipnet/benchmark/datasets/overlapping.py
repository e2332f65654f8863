"""Simulated pairs whose overlap is chosen: most of them between 10 and 30 %."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.options import EvaluateConfig, ProtocolKind
from skipnet.metrics.poses import measured_overlap
from skipnet.simulation.seeds import OVERLAP
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.types import FloatArray, Pair

GOALS = ((0.0, 0.05), (0.15, 0.10), (0.75, 0.30), (1.0, 0.60))
"""(share of the pairs, overlap below which they lie): six of ten have 10 to 30 %."""
TOLERANCE = 0.02
"""A pair may miss its goal by this much."""
SEARCH_STEPS = 10
MIN_POINTS = 2000


@dataclass(frozen=True)
class Kind:
    """One set of the benchmark: scenes, and what scans them."""

    family: str
    """A family of scenes, or "figure"."""
    device: str
    """Of ``skipnet.simulation.scanning.views.DEVICES``; figures have a camera of their own."""
    success_rotation_deg: float = 2.0
    success_translation_m: float = 0.1

    @property
    def name(self) -> str:
        """In tables."""
        return f"{self.family}, {self.device}"


KINDS = (
    Kind("oblique", "dome"),
    Kind("terrain", "dome", success_translation_m=0.3),
    Kind("facade", "rings", success_translation_m=0.3),
    Kind("kitchen", "dome"),
    Kind("clutter", "camera"),
    Kind("kitchen", "camera"),
    Kind("kitchen", "fused"),
    Kind("figure", "camera", 5.0, 0.005),
)


@dataclass(frozen=True)
class Overlapping:
    """Simulated views whose overlap is chosen: ``Dataset``."""

    config: EvaluateConfig

    @property
    def protocol(self) -> ProtocolKind:
        """Each pair's own thresholds."""
        return ProtocolKind.own

    def pairs(self) -> PairSet:
        """See ``overlapping_pairs``."""
        return overlapping_pairs(self.config.pairs, self.config.seed)

    def describe(self) -> dict[str, str]:
        """How many of how many kinds."""
        count = f"{self.config.pairs} simulated pairs of each of {len(KINDS)} kinds"
        return {"pairs from": count}

    def key(self) -> list[Any]:
        """A pair's goal follows from the number of pairs."""
        return ["overlapping", self.config.pairs, self.config.seed]


Clouds = Callable[[float], tuple[FloatArray, FloatArray, FloatArray]]
"""A turn in radians to source (N, 3), target (M, 3) and the true (4, 4) motion."""


def overlapping_pairs(count: int, seed: int = 0) -> PairSet:
    """``count`` pairs of each of ``KINDS``; pair i is of scene number ``seed + i``."""
    if count < 1:
        raise ValueError(f"pairs={count}: expected at least one pair of each kind")
    plan = [(kind, index) for index in range(count) for kind in KINDS]
    seeds = OVERLAP.take(count, skip=seed)
    names = tuple(f"{kind.name}_{seeds[index]}" for kind, index in plan)

    def load(position: int) -> Pair:
        """The planned pair, its scene turned until the overlap is the goal."""
        kind, index = plan[position]
        # The kinds' goals interleave: together they fill the range evenly.
        share = (index + (KINDS.index(kind) + 0.5) / len(KINDS)) / count
        stand_ins = OVERLAP.stand_ins(seed + index)
        return make_pair(kind, stand_ins, goal_overlap(share), names[position])

    return PairSet(names, load)


def goal_overlap(share: float) -> float:
    """The overlap below which ``share`` of the pairs lie.

    >>> goal_overlap(0.0), goal_overlap(0.45), goal_overlap(1.0)
    (0.05, 0.2, 0.6)
    """
    shares, overlaps = zip(*GOALS, strict=True)
    return round(float(np.interp(share, shares, overlaps)), 6)


def make_pair(kind: Kind, seeds: Sequence[int], overlap: float, name: str) -> Pair:
    """The first pair of the kind near that overlap, over the scenes of these seeds.

    Raises:
        ValueError: none of the scenes gave such a pair.
    """
    for seed in seeds:
        clouds, farthest_rad = _scene(kind, seed)
        pair = _search(clouds, farthest_rad, overlap, kind, name)
        if pair is not None:
            return pair
    count = len(seeds)
    raise ValueError(f"{name}: {count} scenes gave no overlap of {overlap:.0%}; take another seed")


def _scene(kind: Kind, seed: int) -> tuple[Clouds, float]:
    """A scene from two sides, and the turn by which these lie apart at most."""
    from skipnet.simulation.scanning import figures, views

    if kind.family == "figure":
        table = figures.turn_figure(seed)
        return (
            lambda turn_rad: (*table.clouds_m(turn_rad), table.T_target_source(turn_rad)),
            figures.FARTHEST_TURN_RAD,
        )
    scene = views.look_around(kind.family, seed, kind.device)
    return (
        lambda turn_rad: (*scene.clouds_m(turn_rad), scene.T_target_source),
        views.FARTHEST_TURN_RAD,
    )


def _search(clouds: Clouds, farthest_rad: float, goal: float, kind: Kind, name: str) -> Pair | None:
    """Bisect the turn, under which the overlap falls; None where it jumps over the goal."""
    low_rad, high_rad = 0.0, farthest_rad
    for _ in range(SEARCH_STEPS):
        turn_rad = 0.5 * (low_rad + high_rad)
        source_m, target_m, T_target_source = clouds(turn_rad)
        if min(len(source_m), len(target_m)) < MIN_POINTS:
            return None
        pair = Pair(
            name=name,
            set_name=kind.name,
            source_m=source_m,
            target_m=target_m,
            T_target_source=T_target_source,
            success_rotation_rad=float(np.deg2rad(kind.success_rotation_deg)),
            success_translation_m=kind.success_translation_m,
        )
        overlap = measured_overlap(pair, choose_voxel_size(source_m, target_m))
        if abs(overlap - goal) < TOLERANCE:
            return pair
        low_rad, high_rad = (turn_rad, high_rad) if overlap > goal else (low_rad, turn_rad)
    return None
