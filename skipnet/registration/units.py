"""Scans in different units: lengths that can only agree after one is scaled are named, not used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.types import FloatArray

METRES_PER_UNIT = {
    "metres": 1.0,
    "feet": 0.3048,
    "centimetres": 0.01,
    "inches": 0.0254,
    "millimetres": 0.001,
}
WITHIN = 2.5
"""Scans of one thing differ in size by less than this factor, or show too little of the same."""
SMALLEST_FACTOR = 2.2
"""Scans whose sizes differ by less may be in one unit."""
WORTH_TRYING = 10.0
"""Those that differ by more are tried in other units ..."""
SURELY_APART = 50.0
"""... and those that differ by so much are of different things, or in different units."""
_ASKED = 20_000


@dataclass(frozen=True)
class UnitGuess:
    """What the numbers of two scans may stand for."""

    factor: float
    """By which the source's coordinates have to be multiplied."""
    source_unit: str
    target_unit: str

    @property
    def is_worth_trying(self) -> bool:
        """A part of a whole is hardly so small."""
        return max(self.factor, 1 / self.factor) > WORTH_TRYING

    @property
    def is_surely_apart(self) -> bool:
        """No part of a whole is so small."""
        return max(self.factor, 1 / self.factor) > SURELY_APART


def size_of(points_m: FloatArray) -> float:
    """Median distance of (N, 3) points from their middle, which strays do not move."""
    some_m = points_m[:: max(1, len(points_m) // _ASKED)]
    return float(np.median(np.linalg.norm(some_m - np.median(some_m, axis=0), axis=1)))


def likeliest_unit(source_size: float, target_size: float) -> UnitGuess | None:
    """The pair of units that brings two sizes closest together; None when one unit may be both's.

    >>> likeliest_unit(2300.0, 2.1)
    UnitGuess(factor=0.001, source_unit='millimetres', target_unit='metres')
    >>> likeliest_unit(2.3, 2.1) is None
    True
    """
    if min(source_size, target_size) <= 0:
        return None
    ratio = target_size / source_size
    if max(ratio, 1 / ratio) < SMALLEST_FACTOR:
        return None
    guesses = [
        UnitGuess(METRES_PER_UNIT[a] / METRES_PER_UNIT[b], a, b)
        for a in METRES_PER_UNIT
        for b in METRES_PER_UNIT
        if a != b and "metres" in (a, b)
    ]
    best = min(guesses, key=lambda guess: abs(np.log(guess.factor / ratio)))
    return best if abs(np.log(best.factor / ratio)) < np.log(WITHIN) else None


def reason_for(guess: UnitGuess, scaled_registers: bool) -> str:
    """What to tell a person."""
    if scaled_registers:
        return (
            f"the sizes agree only if the source is in {guess.source_unit} and the target in "
            f"{guess.target_unit}: scaled by {guess.factor:.4g} the source can be registered; "
            "say so (unit= of the target, source_unit= of the source; in Python "
            "skipnet.read_cloud(path, unit))"
        )
    return (
        f"no pose explains both scans, whose sizes differ as {guess.source_unit} and "
        f"{guess.target_unit} do: check that both are in one unit"
    )
