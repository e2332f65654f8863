"""Scanner models: which beams they send, and what comes back from a scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skipnet.checks import suggestion
from skipnet.geometry import invert, make_transform, transform_points
from skipnet.simulation.scenes.scenes import Scene
from skipnet.types import FloatArray, IntArray


@dataclass(frozen=True)
class Scanner:
    """A scanner that sweeps a regular grid of elevations and azimuths about its z axis."""

    name: str
    channels: int
    """Elevations, evenly spaced from ``lowest_rad`` to ``highest_rad``, both included."""
    azimuth_steps: int
    """Beams of one channel in a full turn."""
    lowest_rad: float
    highest_rad: float
    fixed_channels: bool
    """True for a few lasers; False for a device that samples elevation as finely as azimuth."""
    range_sigma_m: float = 0.004
    """Standard deviation of the range, normal, along the beam."""
    dropout: float = 0.02
    """Share of the returns that are lost, each on its own."""
    min_range_m: float = 0.3
    max_range_m: float = 30.0

    def __post_init__(self) -> None:
        """Refuse values that no scanner can have."""
        allowed = {
            "channels": self.channels >= 1,
            "azimuth_steps": self.azimuth_steps >= 1,
            "lowest_rad": -np.pi / 2 <= self.lowest_rad <= self.highest_rad,
            "highest_rad": self.highest_rad <= np.pi / 2,
            "range_sigma_m": self.range_sigma_m >= 0,
            "dropout": 0 <= self.dropout < 1,
            "max_range_m": 0 <= self.min_range_m < self.max_range_m,
        }
        for name, is_allowed in allowed.items():
            if not is_allowed:
                raise ValueError(
                    f"scanner {self.name!r}: {name} is {getattr(self, name)}; expected one channel "
                    "and step or more, -pi/2 <= lowest <= highest <= pi/2, a range sigma of 0 or "
                    "more, a dropout in [0, 1) and 0 <= min range < max range"
                )

    def with_beams(self, beams: int) -> Scanner:
        """The same scanner sending about ``beams`` beams per scan."""
        if beams < 1:
            raise ValueError(f"points is {beams}; expected the number of beams, 1 or more")
        if self.fixed_channels:
            return replace(self, azimuth_steps=max(1, round(beams / self.channels)))
        step_rad = np.sqrt(2 * np.pi * (self.highest_rad - self.lowest_rad) / beams)
        channels = max(2, round((self.highest_rad - self.lowest_rad) / step_rad))
        return replace(self, channels=channels, azimuth_steps=max(1, round(beams / channels)))

    def directions(self, azimuth_offset_rad: float = 0.0) -> FloatArray:
        """(channels * azimuth_steps, 3) unit vectors of the beams in the sensor's frame."""
        elevation = np.linspace(self.lowest_rad, self.highest_rad, self.channels)[:, None]
        turn = np.linspace(0, 2 * np.pi, self.azimuth_steps, endpoint=False)
        azimuth = turn[None] + azimuth_offset_rad
        directions = np.empty((self.channels, self.azimuth_steps, 3))
        directions[..., 0] = np.cos(elevation) * np.cos(azimuth)
        directions[..., 1] = np.cos(elevation) * np.sin(azimuth)
        directions[..., 2] = np.sin(elevation)
        return directions.reshape(-1, 3)


SCANNERS: dict[str, Scanner] = {
    # A full dome but for the cone that the scanner's own stand hides: 30 deg about the nadir.
    "terrestrial": Scanner(
        "terrestrial", 302, 730, np.deg2rad(-60.0), np.deg2rad(90.0), fixed_channels=False
    ),
    # A spinning LiDAR that does not nod: 16 channels over 30 deg.
    "rings": Scanner("rings", 16, 1800, np.deg2rad(-15.0), np.deg2rad(15.0), fixed_channels=True),
    # What drives on streets: 64 channels, most of them looking down.
    "street": Scanner(
        "street",
        64,
        1800,
        np.deg2rad(-25.0),
        np.deg2rad(15.0),
        fixed_channels=True,
        range_sigma_m=0.01,
        max_range_m=80.0,
    ),
}


@dataclass(frozen=True)
class SimulatedScan:
    """One scan, in the sensor's frame: the sensor is at the origin."""

    points_m: FloatArray
    """(N, 3) float32, with range noise."""
    true_points_m: FloatArray
    """(N, 3) float32, the same returns without noise."""
    surface_of_point: IntArray
    """(N,) int32, the scene's surface each beam hit."""
    T_world_sensor: FloatArray
    """(4, 4) float64."""

    def in_frame_turned_by(self, rotation: FloatArray) -> SimulatedScan:
        """The same scan expressed in a sensor frame turned by the (3, 3) ``rotation``."""
        T_sensor_turned = make_transform(rotation, np.zeros(3))
        T_turned_sensor = invert(T_sensor_turned)
        return replace(
            self,
            points_m=transform_points(T_turned_sensor, self.points_m).astype(np.float32),
            true_points_m=transform_points(T_turned_sensor, self.true_points_m).astype(np.float32),
            T_world_sensor=self.T_world_sensor @ T_sensor_turned,
        )


def scan(scene: Scene, scanner: Scanner, T_world_sensor: FloatArray, seed: int) -> SimulatedScan:
    """Scan a scene from one pose; the same arguments give the same bits.

    Beams that hit nothing, or beyond the scanner's range, return nothing. Every scan starts at a
    random azimuth, so that two scans do not sample the same directions.

    Args:
        scene: what is there.
        scanner: a preset out of `SCANNERS`, or a variation of one.
        T_world_sensor: (4, 4) pose of the sensor.
        seed: of start, noise and dropout, each with its own generator.
    """
    start_rng, noise_rng, dropout_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)
    )
    step_rad = 2 * np.pi / scanner.azimuth_steps
    directions = scanner.directions(start_rng.uniform(0, step_rad))
    rotation = np.asarray(T_world_sensor, dtype=np.float64)[:3, :3]
    hits = scene.raycaster.cast(T_world_sensor[:3, 3], directions @ rotation.T)
    ranges_m = hits.distances
    returned = (ranges_m >= scanner.min_range_m) & (ranges_m <= scanner.max_range_m)
    # Both draws are per beam, not per return: a beam's noise does not depend on what others hit.
    noise_m = noise_rng.normal(0.0, scanner.range_sigma_m, len(ranges_m))
    returned &= dropout_rng.random(len(ranges_m)) >= scanner.dropout
    beams = np.flatnonzero(returned)  # whose rows are copied faster than those of a mask
    directions, ranges_m = directions.take(beams, axis=0), ranges_m[beams, None]
    return SimulatedScan(
        points_m=(directions * (ranges_m + noise_m[beams, None])).astype(np.float32),
        true_points_m=(directions * ranges_m).astype(np.float32),
        surface_of_point=scene.surface_of_triangle[hits.triangle[beams]],
        T_world_sensor=np.asarray(T_world_sensor, dtype=np.float64),
    )


def find_scanner(name: str) -> Scanner:
    """The preset of that name.

    Raises:
        ValueError: no such preset in `SCANNERS`.
    """
    if name not in SCANNERS:
        raise ValueError(f"unknown scanner {name!r}{suggestion(name, tuple(SCANNERS))}")
    return SCANNERS[name]
