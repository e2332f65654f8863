"""What many scans make together: groups, a pose of each scan, a word on each link."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from importlib import import_module

import numpy as np

from skipnet.projects.ways import PairKey
from skipnet.registration.result import PAGES, Registration
from skipnet.scans.given import ScanLike
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status


class Word(str, Enum):
    """What became of the answer of one pair."""

    HOLDS = "holds"
    """Registered, and the final poses agree."""
    REFUTED = "refuted"
    """Registered, but other scans contradict it."""
    OPEN = "open"
    """Registered, but nothing else confirms or refutes it; it had no say."""
    NONE = "none"
    """The pair by itself did not register."""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class FinalLink:
    """Two scans of a group that overlap, in their final poses."""

    overlap: float
    """Share of both scans' surfaces that agrees, 0 to 1."""
    violation: float
    """Share that contradicts seen free space, 0 to 1."""
    closure_m: float
    """How far the final poses put the middle of the overlap from where the pair alone does."""
    weight: float
    """Its say in the pose graph: 1 full, 0 none."""


@dataclass(frozen=True)
class Place:
    """Where a scan in doubt may stand."""

    group: int
    """Number of the group."""
    T_group_scan: FloatArray
    """(4, 4) in the frame of that group's first scan."""


@dataclass(frozen=True)
class Assembly:
    """Where every scan stands, and what that rests on."""

    groups: list[list[int]]
    """Scan numbers, the largest group first; every scan is in exactly one. A scan that nothing
    connects for sure is a group of its own."""
    T_group_scan: list[FloatArray]
    """Per scan the (4, 4) pose in the frame of its group's first scan."""
    status: list[Status]
    """Per scan: registered, or ambiguous: nothing connects it, or it fits in several places."""
    pairs: dict[PairKey, Registration]
    """What registering each tried pair (target, source) gave."""
    words: dict[PairKey, Word]
    """What became of each tried pair's answer."""
    links: dict[PairKey, FinalLink]
    """The pairs that overlap within groups."""
    places: dict[int, list[Place]]
    """Of ambiguous scans, where they may stand, the likeliest first."""
    position_std_m: list[float]
    """Per scan, against its group's first, from the links' information; 0 for the first."""
    rotation_std_rad: list[float]
    """Likewise."""
    reliability: float
    """Share of the registered pairs that hold, of those that can be told: how far a single pair can
    be believed in these scans."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """Seconds per stage."""
    given: Sequence[ScanLike] = field(default=(), repr=False, compare=False)
    """The scans as they were added: paths, or what is in memory."""
    described: Sequence[Scan] = field(default=(), repr=False, compare=False)
    """The same as they were searched."""

    def __str__(self) -> str:
        return f"{self.outcome}: {self.reason}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def save(self, folder: str | os.PathLike[str], format: str = "auto") -> None:
        """Write what the command line writes: poses.json, merged clouds, report.html, a picture.

        Args:
            folder: made when missing; results of an earlier run in it are replaced.
            format: of the merged clouds, beside PLY, such as "laz".
        """
        import_module(PAGES).save_many(self, folder, format)

    def show(self) -> str:
        """Open the report in the browser; the path of its page."""
        return str(import_module(PAGES).show(self))

    def _repr_html_(self) -> str:
        """The outcome and the scans in 3-D, for notebooks."""
        return str(import_module(PAGES).notebook_html_of_many(self))

    @property
    def group_of(self) -> list[int]:
        """Per scan the number of its group."""
        numbers = {scan: number for number, group in enumerate(self.groups) for scan in group}
        return [numbers[scan] for scan in range(len(self.status))]

    @property
    def outcome(self) -> Status:
        """Registered when all scans are in one group; else ambiguous."""
        return Status.REGISTERED if len(self.groups) == 1 else Status.AMBIGUOUS

    @property
    def reason(self) -> str:
        """One sentence for a person."""
        held = sum(word is Word.HOLDS for word in self.words.values())
        refuted = sum(word is Word.REFUTED for word in self.words.values())
        found = f"of {_counted(len(self.pairs), 'pair')} tried {held} hold{'s' * (held == 1)}"
        if refuted:
            found += f" and {refuted} {'is' if refuted == 1 else 'are'} refuted by other scans"
        placed = [group for group in self.groups if len(group) > 1]
        lone = [scan for group in self.groups if len(group) == 1 for scan in group]
        if len(self.groups) == 1:
            return f"{found}; all {len(self.status)} scans are in one frame"
        sizes = " and ".join(str(len(group)) for group in placed) or "no"
        parts = [f"groups of {sizes} scans" if placed else "no two scans are connected for sure"]
        if lone:
            numbers = ", ".join(str(scan) for scan in lone)
            parts.append(f"in doubt: scan{'s' if len(lone) > 1 else ''} {numbers}")
        return f"{found}; {'; '.join(parts)}"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def deviation(covariance: FloatArray) -> tuple[float, float]:
    """Standard deviations of rotation (rad) and position (m) of a (6, 6) covariance."""
    turn = float(np.sqrt(max(np.trace(covariance[:3, :3]), 0.0)))
    return turn, float(np.sqrt(max(np.trace(covariance[3:, 3:]), 0.0)))


def numbered(groups: list[list[int]]) -> Mapping[int, int]:
    """Per scan the number of its group."""
    return {scan: number for number, group in enumerate(groups) for scan in group}
