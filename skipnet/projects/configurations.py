"""Configurations: where all scans stand, and what agrees in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from typing import overload

import numpy as np

from skipnet.projects.groups import Group
from skipnet.projects.ways import PairKey
from skipnet.types import FloatArray, IntArray

ALONE = np.eye(4)
"""Where a scan of its own group is."""
ABOUT_AS_GOOD = 0.8
"""Others than the best are kept that have this share of its merit."""


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
        number = {scan: n for n, one in enumerate(self.poses) for scan in one}
        support = [0.0] * len(self.poses)
        for (target, _), share in self.shares.items():
            support[number[target]] += share
        made = [Group(one, most) for one, most in zip(self.poses, support, strict=True)]
        return sorted(made, key=lambda group: (-len(group.poses), group.scans))


def all_alone(scans: Sequence[int]) -> Configuration:
    """No two scans joined."""
    return Configuration(tuple({scan: ALONE} for scan in scans), {}, {})


@dataclass(frozen=True)
class Packed:
    """A configuration in a tenth of the memory, to the last bit, in the same order."""

    merit: float
    """Of the configuration."""
    scans: IntArray
    """(S,) int32 scans, group by group ..."""
    T_group_scan: FloatArray
    """(S, 3, 4) ... and their poses."""
    sizes: IntArray
    """(G,) int32 scans of each group."""
    shares: tuple[IntArray, FloatArray]
    """(P, 2) uint16 pairs of which something agrees, and (P,) which share."""
    against: tuple[IntArray, FloatArray]
    """(Q, 2) uint16 pairs that contradict, and (Q,) by how many times the limit."""

    @staticmethod
    def of(configuration: Configuration) -> Packed:
        """Pack one."""
        poses = configuration.poses
        return Packed(
            configuration.merit,
            np.array([scan for one in poses for scan in one], dtype=np.int32),
            np.array([T[:3] for one in poses for T in one.values()]),
            np.array([len(one) for one in poses], dtype=np.int32),
            _columns(configuration.shares),
            _columns(configuration.against),
        )

    def unpacked(self) -> Configuration:
        """The configuration."""
        T_group_scan = np.tile(ALONE, (len(self.scans), 1, 1))
        T_group_scan[:, :3] = self.T_group_scan
        rest = zip(self.scans.tolist(), T_group_scan, strict=True)
        poses = tuple(dict(next(rest) for _ in range(size)) for size in self.sizes.tolist())
        return Configuration(poses, _by_pair(*self.shares), _by_pair(*self.against))


class Kept(Sequence[Configuration]):
    """Configurations, each packed until it is asked for: of many scans there are thousands."""

    def __init__(self, packed: Sequence[Packed] = ()) -> None:
        self.packed = packed

    def __len__(self) -> int:
        """How many there are."""
        return len(self.packed)

    @overload
    def __getitem__(self, place: int) -> Configuration: ...

    @overload
    def __getitem__(self, place: slice) -> Kept: ...

    def __getitem__(self, place: int | slice) -> Configuration | Kept:
        """One, or some, which stay packed."""
        if isinstance(place, slice):
            return Kept(self.packed[place])
        return self.packed[place].unpacked()


class Found:
    """What a search comes upon: the first of each name, but for those that turn out too bad."""

    def __init__(self, name: Callable[[Configuration], bytes], known: Kept) -> None:
        """Begin with what is known, which stays packed as it is."""
        self._name = name
        self._packed = list(known.packed)
        self._names = {self._digest(one) for one in known}
        self._most = max((one.merit for one in known.packed), default=-np.inf)

    def add(self, configuration: Configuration) -> None:
        """Keep one, unless one of its name was there, or a much better one of any."""
        digest, merit = self._digest(configuration), configuration.merit
        if digest in self._names:
            return
        self._names.add(digest)
        if merit > self._most or merit >= ABOUT_AS_GOOD * self._most:
            self._packed.append(Packed.of(configuration))
        self._most = max(self._most, merit)

    def _digest(self, configuration: Configuration) -> bytes:
        return blake2b(self._name(configuration), digest_size=16).digest()

    @property
    def ranked(self) -> Kept:
        """The best, and those that are about as good, the better ones first."""
        best = max(self._packed, key=_merit)
        least = ABOUT_AS_GOOD * best.merit
        others = [one for one in self._packed if one is not best and one.merit >= least]
        return Kept([best, *sorted(others, key=_merit, reverse=True)])


def _merit(packed: Packed) -> float:
    return packed.merit


def _columns(of_pairs: dict[PairKey, float]) -> tuple[IntArray, FloatArray]:
    """Pairs and their values."""
    pairs = np.array(list(of_pairs), dtype=np.uint16).reshape(-1, 2)
    return pairs, np.array(list(of_pairs.values()), dtype=np.float64)


def _by_pair(pairs: IntArray, values: FloatArray) -> dict[PairKey, float]:
    """What ``_columns`` was given."""
    return dict(zip(map(tuple, pairs.tolist()), values.tolist(), strict=True))
