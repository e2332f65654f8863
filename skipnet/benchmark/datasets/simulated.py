"""Pairs of simulated scenes, made on demand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.options import EvaluateConfig, ProtocolKind
from skipnet.checks import check_known
from skipnet.types import Pair


@dataclass(frozen=True)
class Simulated:
    """Scenes of one family, or of every one: ``Dataset``."""

    config: EvaluateConfig

    @property
    def protocol(self) -> ProtocolKind:
        """Each pair's own thresholds."""
        return ProtocolKind.own

    def pairs(self) -> PairSet:
        """See ``simulated_pairs``."""
        c = self.config
        return simulated_pairs(c.family, c.pairs, c.seed, c.scanner, c.rotation, c.points)

    def describe(self) -> dict[str, str]:
        """Family, number and scanner."""
        c = self.config
        family = "every family" if c.family == "all" else f"family {c.family}"
        return {
            "pairs from": f"{c.pairs} simulated scenes of {family}",
            "scanner": f"{c.scanner}, rotation {c.rotation}",
        }

    def key(self) -> list[Any]:
        """A pair's name has family and seed."""
        return ["simulated", self.config.scanner, self.config.rotation, self.config.points]


def simulated_pairs(
    family: str,
    count: int,
    seed: int = 0,
    scanner: str = "terrestrial",
    rotation: str = "yaw",
    points: int | None = None,
) -> PairSet:
    """``count`` simulated pairs of one family, or of all; pair i is of scene number ``seed + i``.

    Args:
        family: one of ``skipnet.simulation.scenes.scenes.FAMILIES``, or "all": ``count``
            pairs of each whose scans have one answer only.
        count: number of pairs, at least 1.
        seed: number of the first scene among those of ``skipnet.simulation.seeds.BENCHMARK``.
        scanner: one of ``skipnet.simulation.scanning.scanner.SCANNERS``.
        rotation: "yaw" keeps the second scanner upright, "any" turns it freely.
        points: beams per scan; None takes the scanner's own number.
    """
    from skipnet.simulation.scanning.pairs import ROTATIONS, simulate_pair
    from skipnet.simulation.scanning.scanner import SCANNERS
    from skipnet.simulation.scenes.scenes import AMBIGUOUS_FAMILIES, FAMILIES
    from skipnet.simulation.seeds import BENCHMARK

    if count < 1:
        raise ValueError(f"pairs={count}: expected at least one simulated pair")
    # Here, not at the first pair: a run that cannot start should leave no folder behind.
    check_known("family", family, ("all", *FAMILIES))
    check_known("scanner", scanner, tuple(SCANNERS))
    check_known("rotation", rotation, ROTATIONS)
    unique = [one for one in FAMILIES if one not in AMBIGUOUS_FAMILIES]
    families = unique if family == "all" else [family]
    plan = [(one, of_scene) for one in families for of_scene in BENCHMARK.take(count, skip=seed)]
    names = tuple(f"{one}_{of_scene}" for one, of_scene in plan)

    def load(index: int) -> Pair:
        """The planned scene of that index, scanned from two places."""
        one, of_scene = plan[index]
        simulated = simulate_pair(one, of_scene, scanner, rotation, points)
        return replace(simulated.pair, name=names[index])

    return PairSet(names, load)
