"""What a family of scenes hands over: surfaces, and where sensors may stand."""

from __future__ import annotations

from dataclasses import dataclass

from skipnet.simulation.shapes import Surface


@dataclass(frozen=True)
class Station:
    """A ring on the floor in which one sensor may stand."""

    centre_m: tuple[float, float]
    nearest_m: float
    """Inner radius; with 0 for both radii the sensor stands exactly at the centre."""
    farthest_m: float
    """Outer radius."""


@dataclass(frozen=True)
class Draft:
    """What a family draws."""

    surfaces: list[Surface]
    stations: tuple[Station, ...]
    """One per scan; further scans repeat the last."""


CENTRE_THEN_MOVED = (Station((0.0, 0.0), 0.0, 0.0), Station((0.0, 0.0), 1.0, 3.0))
"""The paper's two stations: the room's centre, and 1 to 3 m away from it."""
