"""What somebody believes of many scans: rough places, known links. It is judged, never trusted."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt

from skipnet.checks import require
from skipnet.geometry import invert
from skipnet.projects.ways import PairKey
from skipnet.registration.prior import Prior
from skipnet.types import FloatArray

FAR_STDS = 3.0
"""Positions that are off by more than this many standard deviations are wrong."""


@dataclass(frozen=True)
class Priors:
    """What is believed of scans, by their numbers.

    Nothing of it enters a decision. A pose is one more hypothesis of its pair and is judged like
    those that the scans themselves propose; a link is searched with all generators at once; a
    position says which pairs are asked first, and with a non-link, which are not worth a costly
    search.
    """

    positions_m: Mapping[int, npt.ArrayLike] = field(default_factory=dict)
    """(3,) place of scans in one frame, as of GNSS."""
    position_std_m: float = 5.0
    """How far each of these may be off."""
    poses: Mapping[int, Prior] = field(default_factory=dict)
    """Pose of scans in one frame: ``T_target_source`` maps the scan's frame into it."""
    links: Mapping[PairKey, Prior | None] = field(default_factory=dict)
    """(target, source) pairs that are said to overlap, with a pose where one is known."""
    non_links: Collection[PairKey] = ()
    """Pairs that are said to share nothing."""

    def __post_init__(self) -> None:
        require(
            0 < self.position_std_m < math.inf, "position_std_m", self.position_std_m, "above 0"
        )
        for scan, position_m in self.positions_m.items():
            place = np.asarray(position_m, dtype=np.float64)
            if place.shape != (3,) or not np.isfinite(place).all():
                raise ValueError(f"priors: position of scan {scan}: expected three finite numbers")
        for target, source in [*self.links, *self.non_links]:
            if target == source:
                raise ValueError(f"priors: scan {target} is linked with itself")

    def check(self, count: int) -> None:
        """Raise ValueError where a scan is named that is not among ``count``."""
        pairs = [*self.links, *self.non_links]
        named = {*self.positions_m, *self.poses, *(scan for pair in pairs for scan in pair)}
        missing = sorted(scan for scan in named if not 0 <= scan < count)
        if missing:
            raise ValueError(f"priors: there is no scan {missing[0]}: got {count} scans")

    @property
    def linked(self) -> set[PairKey]:
        """Pairs that are said to overlap, the smaller number first."""
        return {(min(pair), max(pair)) for pair in self.links}

    def guesses(self, reach_m: float) -> dict[PairKey, Prior]:
        """Of pairs for which a pose is believed, the pose of the larger number's scan in the
        smaller one's frame; those of ``poses`` where the scans stand less than reach_m apart."""
        found: dict[PairKey, Prior] = {}
        for a, b in combinations(sorted(self.poses), 2):
            T_a, T_b = (np.asarray(self.poses[s].T_target_source, np.float64) for s in (a, b))
            if np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]) < reach_m:
                found[a, b] = _between(invert(T_a) @ T_b, self.poses[a], self.poses[b])
        for (target, source), prior in self.links.items():
            if prior is not None:
                T = np.asarray(prior.T_target_source, np.float64)
                key = (min(target, source), max(target, source))
                found[key] = _between(T if key[0] == target else invert(T), prior)
        return found

    def apart_m(self, key: PairKey) -> float:
        """How far two scans are believed to stand apart; 0 where nothing is believed."""
        ends = [self._position_m(scan) for scan in key]
        if ends[0] is None or ends[1] is None:
            return 0.0
        return float(np.linalg.norm(ends[0] - ends[1]))

    def is_hopeless(self, key: PairKey, reach_m: float) -> bool:
        """Whether a costly search of a pair is not worth while by what is believed."""
        said = {(min(pair), max(pair)) for pair in self.non_links}
        slack_m = FAR_STDS * math.sqrt(2) * self.position_std_m
        return key in said or self.apart_m(key) > reach_m + slack_m

    def _position_m(self, scan: int) -> FloatArray | None:
        if scan in self.positions_m:
            return np.asarray(self.positions_m[scan], dtype=np.float64)
        if scan in self.poses:
            return np.asarray(self.poses[scan].T_target_source, np.float64)[:3, 3]
        return None


def _between(T_target_source: FloatArray, *priors: Prior) -> Prior:
    """A pose whose deviations are those of all that it comes from, together."""

    def pooled(stds: list[float | None]) -> float | None:
        known = [std for std in stds if std is not None]
        return math.sqrt(sum(std**2 for std in known)) if len(known) == len(stds) else None

    return Prior(
        T_target_source,
        pooled([prior.position_std_m for prior in priors]),
        pooled([prior.rotation_std_deg for prior in priors]),
    )
