"""What one timed run of a method on a pair gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Measurement:
    """One method on one pair."""

    family: str
    size: int
    """Points of each scan that were asked for."""
    method: str
    seed: int
    """Of the scene."""
    points: int
    """Points of both scans together."""
    time_s: float
    is_right: bool
    """Whether the pose lies within the pair's success thresholds."""
    stages_s: Mapping[str, float] = field(default_factory=dict)
    """Seconds of each stage, as far as the method tells."""
    input_bytes: int = 0
    extra_bytes: int | None = None
    """Peak memory beyond the two scans themselves; None where it was not measured."""
    error: str = ""
    """What it raised."""
