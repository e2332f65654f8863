"""Lengths as their reader counts them: in the unit of the files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.checks import METRES_PER_UNIT
from skipnet.types import FloatArray

_LEAST = 1e-4
"""Nothing that is measured is smaller."""
_SMALL = {"ft": "in", "us_ft": "in", "in": "in"}


@dataclass(frozen=True)
class Lengths:
    """Metres in words and numbers of another unit."""

    unit: str = "m"
    """A key of ``METRES_PER_UNIT``: that of the target's file, in whose frame results are."""

    @property
    def small_unit(self) -> str:
        """The unit of what is small: millimetres, or inches where feet are counted."""
        return _SMALL.get(self.unit, "mm")

    def small(self, length_m: float) -> str:
        """A small length in words.

        >>> Lengths().small(0.0123), Lengths("ft").small(0.0127)
        ('12.3 mm', '0.5 in')
        >>> Lengths().small(4e-17)
        'below 0.0001 mm'
        """
        length = self.in_small(length_m)
        if 0 <= length < _LEAST:
            return f"below {_LEAST:g} {self.small_unit}"
        return f"{length:.3g} {self.small_unit}"

    def large(self, length_m: float) -> str:
        """A large length in words.

        >>> Lengths().large(1234.5), Lengths("mm").large(1.5)
        ('1,234 m', '1,500 mm')
        """
        return f"{length_m / METRES_PER_UNIT[self.unit]:,.0f} {self.unit}"

    def in_small(self, length_m: float) -> float:
        """A length in ``small_unit``."""
        return length_m / METRES_PER_UNIT[self.small_unit]

    def pose(self, T_m: FloatArray) -> FloatArray:
        """A (4, 4) pose whose translation is in the unit."""
        T = np.array(T_m, np.float64)
        T[:3, 3] /= METRES_PER_UNIT[self.unit]
        return T
