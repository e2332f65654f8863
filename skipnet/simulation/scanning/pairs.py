"""Pairs of simulated scans with their true transform: the paper's experiment, for any family."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.checks import suggestion
from skipnet.geometry import invert, random_rotation, transform_points
from skipnet.simulation.scanning.scanner import SimulatedScan, find_scanner, scan
from skipnet.simulation.scenes.scenes import Scene, make_scene, place_sensors
from skipnet.types import BoolArray, FloatArray, Pair

ROTATIONS = ("yaw", "any")
SIGHT_TOLERANCE_M = 0.001


@dataclass(frozen=True)
class SimulatedPair:
    """Two scans of one scene; the target is the paper's first scan, from the room's centre."""

    name: str
    scene: Scene
    source: SimulatedScan
    target: SimulatedScan
    overlap: float
    """Share of the source's points in free sight of the target's sensor, whatever it sampled."""

    @property
    def T_target_source(self) -> FloatArray:
        """(4, 4) the true motion from the source's frame to the target's."""
        return invert(self.target.T_world_sensor) @ self.source.T_world_sensor

    @property
    def pair(self) -> Pair:
        """What methods and scorers take; both sensors stand at their cloud's origin."""
        return Pair(
            name=self.name,
            set_name=self.scene.family,
            source_m=self.source.points_m,
            target_m=self.target.points_m,
            T_target_source=self.T_target_source,
            source_viewpoint_m=np.zeros(3),
            target_viewpoint_m=np.zeros(3),
            overlap=self.overlap,
        )


def simulate_pair(
    family: str,
    seed: int,
    scanner: str = "terrestrial",
    rotation: str = "yaw",
    points: int | None = None,
) -> SimulatedPair:
    """Scan scene ``seed`` of a family from two places; the same arguments give the same bits.

    Args:
        family: one of `skipnet.simulation.scenes.scenes.FAMILIES`.
        seed: of the scene, the poses and the scanners' errors, each with its own generator.
        scanner: one of `skipnet.simulation.scanning.scanner.SCANNERS`.
        rotation: "yaw": the target keeps the world's axes, the source is turned about z by any
            angle, as in the paper. "any": the scanners stand upright all the same, but each cloud
            comes in a frame turned by a rotation uniform on SO(3).
        points: number of beams of each scan; None for the scanner's own.

    Raises:
        ValueError: unknown family, scanner or rotation; the message lists what exists.
    """
    scans, scene = simulate_scans(family, seed, 2, scanner, rotation, points)
    target, source = scans
    return SimulatedPair(
        name=f"{family}_{seed:04d}",
        scene=scene,
        source=source,
        target=target,
        overlap=float(in_sight(scene, source, target, find_scanner(scanner).max_range_m).mean()),
    )


def simulate_scans(
    family: str,
    seed: int,
    count: int,
    scanner: str = "terrestrial",
    rotation: str = "yaw",
    points: int | None = None,
) -> tuple[list[SimulatedScan], Scene]:
    """As `simulate_pair`, from ``count`` places; the first stands at the room's centre."""
    if rotation not in ROTATIONS:
        raise ValueError(f"unknown rotation {rotation!r}{suggestion(rotation, ROTATIONS)}")
    model = find_scanner(scanner)
    if points is not None:
        model = model.with_beams(points)
    scene = make_scene(family, seed)
    # The scene draws from `seed` itself; the children are for what happens in it.
    pose_seed, turn_seed, *scan_seeds = np.random.SeedSequence(seed).generate_state(count + 2)
    poses = place_sensors(scene, count, int(pose_seed))
    scans = [scan(scene, model, T, int(s)) for T, s in zip(poses, scan_seeds, strict=True)]
    if rotation == "any":
        rng = np.random.default_rng(int(turn_seed))
        scans = [one.in_frame_turned_by(random_rotation(rng)) for one in scans]
    return scans, scene


def in_sight(
    scene: Scene, seen: SimulatedScan, other: SimulatedScan, max_range_m: float
) -> BoolArray:
    """(N,) whether the other scan's sensor has each point of ``seen`` in free sight and range."""
    points_world_m = transform_points(seen.T_world_sensor, seen.true_points_m)
    sensor_m = other.T_world_sensor[:3, 3]
    ways_m = points_world_m - sensor_m
    distance_m = np.linalg.norm(ways_m, axis=1)
    # The ray caster measures in lengths of the way: 1 is the point itself, less is in front of it.
    blocked_at_m = scene.raycaster.cast(sensor_m, ways_m).distances * distance_m
    return (blocked_at_m > distance_m - SIGHT_TOLERANCE_M) & (distance_m <= max_range_m)
