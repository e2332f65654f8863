"""What real scenes do between two scans: people walk through and stand in the way."""

from __future__ import annotations

import numpy as np

from skipnet.types import FloatArray


def add_passers_by(points_m: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Let ``count`` obstacles stop the beams of a scan taken from its origin.

    Each obstacle is a shield that faces the sensor, 3 to 9 degrees in radius, at 30 to 80 % of the
    way to what stood behind it: as seen from the sensor a person, a car, a box left behind.

    Args:
        points_m: (N, 3) scan with the sensor at the origin.
        count: number of obstacles.
        rng: draws where they stand.

    Returns:
        (N, 3) points, those behind an obstacle moved onto it; of the same type.
    """
    moved_m = np.array(points_m)
    range_m = np.linalg.norm(points_m, axis=1)
    direction = points_m / np.maximum(range_m, 1e-9)[:, None]
    for _ in range(count):
        centre = int(rng.integers(len(points_m)))
        shield = direction @ direction[centre] > np.cos(np.deg2rad(rng.uniform(3, 9)))
        distance_m = rng.uniform(0.3, 0.8) * range_m[centre]
        behind = shield & (range_m > distance_m)
        shield_m = distance_m * rng.normal(1, 2e-3, (behind.sum(), 1))
        moved_m[behind] = direction[behind] * shield_m
    return moved_m
