"""Many scans of simulated office floors, in any order, for the registration of many scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.checks import suggestion
from skipnet.geometry import random_rotation
from skipnet.simulation.scanning.scanner import SimulatedScan, find_scanner, scan
from skipnet.simulation.scenes.floors import office_floor
from skipnet.simulation.scenes.scenes import assemble, place_sensors

KINDS = ("floor", "twins", "long_corridor", "two_buildings")
"""What can be simulated: a floor, one with two rooms furnished exactly alike, one with scans in one
room out of three along a long corridor, and the scans of two floors mixed."""


@dataclass(frozen=True)
class ScannedFloor:
    """Scans in random order, each in a freely turned frame, and which building each is of."""

    scans: list[SimulatedScan]
    building: list[int]


def simulate_floor(kind: str, seed: int, count: int, points: int = 100_000) -> ScannedFloor:
    """Scan a floor; the same arguments give the same bits.

    Args:
        kind: one of ``KINDS``.
        seed: of the floor, the places, the scanners' errors and the order.
        count: scans in all.
        points: beams of each scan.

    Raises:
        ValueError: unknown kind.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of floor {kind!r}{suggestion(kind, KINDS)}")
    buildings = 2 if kind == "two_buildings" else 1
    seeds = np.random.SeedSequence(seed)
    shares = [count // buildings + (number < count % buildings) for number in range(buildings)]
    of_each = [
        _scan_floor(kind, child, share, points)
        for child, share in zip(seeds.spawn(buildings), shares, strict=True)
    ]
    order = np.random.default_rng(seeds.spawn(1)[0]).permutation(count)
    scans = [one for scans in of_each for one in scans]
    building = np.repeat(np.arange(buildings), shares)
    return ScannedFloor([scans[k] for k in order], building[order].tolist())


def _scan_floor(
    kind: str, seeds: np.random.SeedSequence, count: int, points: int
) -> list[SimulatedScan]:
    floor_seed, place_seed, turn_seed, *scan_seeds = seeds.generate_state(3 + count)
    draft = office_floor(
        np.random.default_rng(floor_seed),
        count,
        twins=kind == "twins",
        spread=3.0 if kind == "long_corridor" else 1.0,
    )
    scene = assemble(kind, int(floor_seed), draft)
    scanner = find_scanner("terrestrial").with_beams(points)
    poses = place_sensors(scene, count, int(place_seed))
    rng = np.random.default_rng(turn_seed)
    return [
        scan(scene, scanner, T, int(s)).in_frame_turned_by(random_rotation(rng))
        for T, s in zip(poses, scan_seeds, strict=True)
    ]
