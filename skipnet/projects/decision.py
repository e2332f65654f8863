"""What is decided of all scans: who stands together, and what is in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skipnet.projects.groups import Group
from skipnet.projects.ways import PairKey
from skipnet.types import FloatArray


@dataclass(frozen=True)
class Decision:
    """Groups of scans, the largest first, and what is in doubt."""

    groups: list[Group]
    """Those of one scan included."""
    places: Mapping[int, list[FloatArray]]
    """Of every scan in doubt, where it may stand, the likeliest first: (4, 4) poses of its own
    frame in that of the group ``host`` ..."""
    host: Mapping[int, int]
    """... whose lowest scan number this is."""
    reliability: float
    """Share of the registered pairs that hold, of those that could be told."""
    unsure: Mapping[PairKey, FloatArray] = field(default_factory=dict)
    """Pairs whose word would settle whether groups belong together, and (4, 4) the pose of the
    second scan's own frame in the first one's that they would have."""

    @property
    def placed(self) -> int:
        """Scans that stand in a group with others."""
        return sum(len(group.poses) for group in self.groups if len(group.poses) > 1)
