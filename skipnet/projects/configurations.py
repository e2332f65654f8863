"""Configurations: where all scans stand, and what agrees in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skipnet.projects.groups import Group
from skipnet.projects.ways import PairKey
from skipnet.types import FloatArray

ALONE = np.eye(4)
"""Where a scan of its own group is."""


@dataclass(frozen=True)
class Configuration:
    """Groups of scans, with what agrees in them."""

    poses: tuple[dict[int, FloatArray], ...]
    """Per group the (4, 4) pose of each scan's own frame, in the group's."""
    shares: dict[PairKey, float]
    """Of each pair of one group of which something agrees, which share of the surfaces."""
    against: dict[PairKey, float]
    """Of each pair of one group that sees the same by how many times the limit it contradicts,
    stray voxels included: where scans stand right next to none do, and few tell alike rooms
    apart."""

    @cached_property
    def merit(self) -> float:
        """How much agrees, less what contradicts: a limit's worth of it outweighs a whole scan.

        Without the last digits, in which sums of another order differ.
        """
        return round(sum(self.shares.values()) - sum(self.against.values()), 6)

    @cached_property
    def groups(self) -> list[Group]:
        """The largest first."""
        made = [
            Group(one, sum(share for key, share in self.shares.items() if key[0] in one))
            for one in self.poses
        ]
        return sorted(made, key=lambda group: (-len(group.poses), group.scans))


def all_alone(scans: Sequence[int]) -> Configuration:
    """No two scans joined."""
    return Configuration(tuple({scan: ALONE} for scan in scans), {}, {})
