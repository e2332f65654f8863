"""Ways to join groups of scans: what speaks for each, and which explain the scans as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.types import FloatArray

PairKey = tuple[int, int]
"""Numbers of (target, source), the smaller one first."""
MIN_SUPPORT = 0.03
"""A join in which less than this agrees rests on nothing."""
MOST_OVERLAP = 0.75
"""Two scans of which more agrees may be of two rooms furnished alike as well as of one."""
RIVAL_CONTRADICTION = 0.5
"""A way that contradicts by this share of the limit more than the best one is no rival."""
MANY_VOTES = 3
"""More pairs than this that propose a way say nothing more."""


@dataclass(frozen=True)
class Standards:
    """How much a set of scans must agree."""

    limit: float
    """Largest contradiction of a join, as a share of what can be compared."""
    rival_support: float
    """Another way to join two groups with this share of the best one's support is a rival."""
    severity: float = 3.0
    """How fast contradiction devalues support: at the limit to exp(-severity)."""
    believes_one: bool = False
    """Whether one pair is enough to join groups of several scans, if it registered by itself. Else
    several must agree, but a scan may join by a pair that did not register."""
    least_trust: float = 0.0
    """If above 0: two groups are only joined by a pair that is so sure by itself."""
    most_overlap: float = 1.0
    """Two scans of which more agrees are not laid on each other in the search for configurations:
    they may be of two rooms furnished alike as well as of one."""


@dataclass(frozen=True)
class Way:
    """One way to join two groups, and what it rests on."""

    T: FloatArray
    """(4, 4) from the second group's frame to the first's."""
    voters: frozenset[PairKey]
    """Pairs of scans that proposed it, each on its own."""
    trust: float
    """Largest confidence of a voter for whom it is the answer."""
    support: float
    contradiction: float
    witnesses: int
    closest: float
    """See ``Testimony``, which has these four."""

    def worth(self, standards: Standards) -> float:
        """Support, devalued by contradiction."""
        share = self.contradiction / standards.limit
        return self.support * float(np.exp(-standards.severity * share))

    def fits(self, standards: Standards) -> bool:
        """Whether something speaks for it, and next to nothing against it."""
        return self.support >= MIN_SUPPORT and self.contradiction <= standards.limit

    def rank(self, standards: Standards) -> tuple[float, float]:
        """Orders joins: more independent proposals first, then what is worth most."""
        return min(len(self.voters), MANY_VOTES), self.worth(standards)


def rivals(ways: Sequence[Way], standards: Standards) -> list[Way]:
    """The ways that explain the scans about as well as the best one, which comes first."""
    limit = standards.limit
    fitting = [way for way in ways if way.fits(standards)]
    if not fitting:
        return []
    best = max(fitting, key=lambda way: way.worth(standards))
    return [best] + [
        way
        for way in fitting
        if way is not best
        and way.support >= standards.rival_support * best.support
        and way.contradiction <= best.contradiction + RIVAL_CONTRADICTION * limit
    ]
