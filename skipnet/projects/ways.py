"""Groups of scans, and the ways in which two of them may be joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skipnet.projects.groups import MANY_VOTES, PairKey
from skipnet.types import FloatArray

SAME_VOXELS = 3.0
"""Two links put a group in about the same place when its centre is less than this apart."""


@dataclass(frozen=True)
class Proposals:
    """What searching one pair of scans proposed, the answer first."""

    T_target_source: FloatArray
    """(H, 4, 4) between the scans' own frames."""
    overlap: FloatArray
    """(H,) share of the surfaces that agree."""
    violation: FloatArray
    """(H,) share that contradicts seen free space."""
    confidence: float
    """Of the first, if it is registered; else 0."""


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
    """Whether one pair is enough to join groups of several scans."""


@dataclass(frozen=True)
class Group:
    """Scans whose relative poses are decided."""

    poses: Mapping[int, FloatArray]
    """(4, 4) of each scan's own frame, in the group's."""
    support: float = 0.0
    """Sum over all pairs of scans of the share of surfaces that agree."""

    @property
    def scans(self) -> list[int]:
        """In ascending order."""
        return sorted(self.poses)

    def without(self, scan: int) -> Group:
        """The others where they are; the support is not known anew."""
        return Group({other: T for other, T in self.poses.items() if other != scan})

    @staticmethod
    def single(scan: int) -> Group:
        """A scan alone, in its own frame."""
        return Group({scan: np.eye(4)})


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
    """See ``Testimony``, which has these three."""

    def worth(self, standards: Standards) -> float:
        """Support, devalued by contradiction."""
        share = self.contradiction / standards.limit
        return self.support * float(np.exp(-standards.severity * share))

    def rank(self, standards: Standards) -> tuple[int, float]:
        """Orders joins: more independent proposals first, then what is worth most."""
        return min(len(self.voters), MANY_VOTES), self.worth(standards)
