"""Two views of one scene that look apart by any angle: pairs whose overlap can be chosen.

Full scans from a few places are made once; a view is what a cone of directions keeps of one. The
farther the source's cone turns away from the target's, the less both have seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skipnet.checks import suggestion
from skipnet.geometry import invert, rotation_from_vector, transform_points
from skipnet.simulation.scanning.degrading import blur_depth, fuse, in_cone
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.simulation.scanning.scanner import SimulatedScan
from skipnet.types import FloatArray

FARTHEST_TURN_RAD = np.deg2rad(150.0)
"""Views that look apart by this much hardly ever share anything."""
HIGHEST_RAD = np.deg2rad(5.0)
DOWN_RAD = np.deg2rad(-35.0)
"""Cameras are held level or look down on what stands there, by up to this much."""
MOST_TIP_RAD = np.deg2rad(25.0)
"""The axis about which the source turns away is tipped from the vertical by less than this."""


@dataclass(frozen=True)
class Device:
    """What takes the scans of a cloud, and how much of them it keeps."""

    scanner: str
    """A preset of ``skipnet.simulation.scanning.scanner.SCANNERS``."""
    beams: int
    """Of each full scan."""
    half_angle_rad: tuple[float, float]
    """Range of the half-angle of the cone that a view keeps."""
    places: int = 1
    """Views fused into each cloud; with more than one the cloud has no viewpoint."""
    lowest_rad: float = np.deg2rad(-10.0)
    """The target looks between this elevation and ``HIGHEST_RAD``."""
    depth_noise_per_m: float = 0.0
    """Deviation of the range, in metres, at a range of 1 m; it grows with the range's square."""


DEVICES: dict[str, Device] = {
    "dome": Device("terrestrial", 300_000, (np.deg2rad(55), np.deg2rad(75))),
    "rings": Device("street", 115_000, (np.deg2rad(55), np.deg2rad(80))),
    "camera": Device(
        "terrestrial",
        500_000,
        (np.deg2rad(26), np.deg2rad(38)),
        lowest_rad=DOWN_RAD,
        depth_noise_per_m=0.0015,
    ),
    "fused": Device(
        "terrestrial",
        300_000,
        (np.deg2rad(26), np.deg2rad(38)),
        places=2,
        lowest_rad=DOWN_RAD,
        depth_noise_per_m=0.001,
    ),
}


@dataclass(frozen=True)
class Views:
    """A scene from the places of two clouds, target and source, with the directions still open."""

    target: Sequence[SimulatedScan]
    """Full scans from the target's places; the first one's frame is the cloud's."""
    source: Sequence[SimulatedScan]
    half_angle_rad: float
    """Of every view's cone."""
    ahead: FloatArray
    """(3,) unit vector, target frame: where the target looks."""
    axis: FloatArray
    """(3,) unit vector, target frame, across ``ahead``: the source turns away about it."""

    @property
    def T_target_source(self) -> FloatArray:
        """(4, 4) the true motion."""
        return invert(self.target[0].T_world_sensor) @ self.source[0].T_world_sensor

    def clouds_m(self, turn_rad: float) -> tuple[FloatArray, FloatArray]:
        """(N, 3) source and (M, 3) target, each in its own frame.

        Both look at points of the target's full scan: the target straight ahead, the source at the
        one that the target would see after turning by ``turn_rad``.
        """
        there = rotation_from_vector(turn_rad * self.axis) @ self.ahead
        return self._cloud(self.source, there), self._cloud(self.target, self.ahead)

    def _cloud(self, scans: Sequence[SimulatedScan], way: FloatArray) -> FloatArray:
        """What the scans see about the point that lies in direction (3,) ``way`` of the target."""
        points_m = self.target[0].points_m
        aside = points_m @ way / np.linalg.norm(points_m, axis=1)
        focus_m = transform_points(self.target[0].T_world_sensor, points_m[[aside.argmax()]])
        seen_m = []
        for scan in scans:
            axis = transform_points(invert(scan.T_world_sensor), focus_m)[0]
            seen_m.append(scan.points_m[in_cone(scan.points_m, axis, self.half_angle_rad)])
        return fuse(seen_m, [scan.T_world_sensor for scan in scans])


def look_around(family: str, seed: int, device: str) -> Views:
    """Scan scene ``seed`` of a family for two clouds in freely turned frames.

    Args:
        family: one of ``skipnet.simulation.scenes.scenes.FAMILIES``.
        seed: of the scene, the places, the scanners' errors and the directions.
        device: one of ``DEVICES``.

    Raises:
        ValueError: unknown family or device; the message lists what exists.
    """
    if device not in DEVICES:
        raise ValueError(f"unknown device {device!r}{suggestion(device, tuple(DEVICES))}")
    model = DEVICES[device]
    rng = np.random.default_rng([seed, 3])
    scans, _ = simulate_scans(family, seed, 2 * model.places, model.scanner, "any", model.beams)
    if model.depth_noise_per_m > 0:
        noisy_m = (blur_depth(scan.points_m, model.depth_noise_per_m, rng) for scan in scans)
        scans = [replace(scan, points_m=p) for scan, p in zip(scans, noisy_m, strict=True)]
    # Places 0 and 1 are those of a pair; each further one joins the cloud of one of them.
    target, source = scans[::2], scans[1::2]
    up = target[0].T_world_sensor[:3, :3].T @ [0.0, 0.0, 1.0]
    ahead = _way_ahead(target[0].points_m, up, model.lowest_rad, rng)
    axis = up + rng.normal(0, np.tan(MOST_TIP_RAD) / 2, 3)
    axis -= (axis @ ahead) * ahead
    return Views(
        target=target,
        source=source,
        half_angle_rad=rng.uniform(*model.half_angle_rad),
        ahead=ahead,
        axis=rng.choice([-1.0, 1.0]) * axis / np.linalg.norm(axis),
    )


def _way_ahead(
    points_m: FloatArray, up: FloatArray, lowest_rad: float, rng: np.random.Generator
) -> FloatArray:
    """(3,) unit vector towards one of the (N, 3) points that lie level or below the sensor."""
    ways = points_m / np.linalg.norm(points_m, axis=1, keepdims=True)
    sine = ways @ up
    chosen = np.flatnonzero((np.sin(lowest_rad) < sine) & (sine < np.sin(HIGHEST_RAD)))
    way: FloatArray = ways[rng.choice(chosen)].astype(np.float64)
    return way / np.linalg.norm(way)
