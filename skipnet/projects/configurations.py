"""Where does every scan stand? The configuration is sought in which most agrees.

Joins are made one by one, the most promising first, and an early wrong one keeps out right ones. So
this is done again and again, with joins in other orders, and from the best configuration so far of
which some scans were taken out. Nothing is believed here: of all that was found, that is best of
which most agrees, and what else was found nearly as good tells what is in doubt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, straightened
from skipnet.projects.components import components
from skipnet.projects.groups import SAME_VOXELS, Group, Proposals
from skipnet.projects.ways import MIN_SUPPORT, PairKey, Standards
from skipnet.projects.witness import LITTLE_OVERLAP, MIN_OVERLAP, STRAY_SHARE, Witness, leaders
from skipnet.types import BoolArray, FloatArray, IntArray

FRESH = 6
"""Configurations that are made from single scans."""
PATIENCE = 60
"""So many attempts without a better one end the search, ..."""
PATIENCE_PER_SCAN = 3
"""... and so many for each scan."""
SPREAD = 0.7
"""Standard deviation of the logarithm of the factor by which a join counts more or less."""
FEWEST_OUT, MOST_OUT = 0.1, 0.6
"""Least and largest share of the scans that is taken out, but no more scans than ..."""
MANY_OUT = 12
TRIES_ELSEWHERE = 4
"""Times that each scan is put elsewhere than where it stands best."""
ABOUT_AS_GOOD = 0.8
"""Others are kept that have this share of the best merit."""
WORTH_GOING_ON = 0.001
"""A configuration that is better by less is no reason to go on."""
_SAME_TURN = 0.2
"""Axes that differ by less are about the same, as far as a name goes."""
SLACK = 0.01
"""A configuration that is worse by this share is gone on from, too."""


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

    @property
    def merit(self) -> float:
        """How much agrees, less what contradicts: a limit's worth of it outweighs a whole scan.

        Without the last digits, in which sums of another order differ.
        """
        return round(sum(self.shares.values()) - sum(self.against.values()), 6)

    @property
    def groups(self) -> list[Group]:
        """The largest first."""
        made = [
            Group(one, sum(share for key, share in self.shares.items() if key[0] in one))
            for one in self.poses
        ]
        return sorted(made, key=lambda group: (-len(group.poses), group.scans))


@dataclass(frozen=True)
class Edges:
    """E proposals that nothing speaks against, each by itself."""

    ends: IntArray
    """(E, 2) numbers of target and source."""
    T_target_source: FloatArray
    """(E, 4, 4)"""
    weight: FloatArray
    """(E,) how promising each is."""


def first_configuration(
    scans: Sequence[int],
    proposals: Mapping[PairKey, Proposals],
    witness: Witness,
    standards: Standards,
) -> Configuration:
    """What joining by the most promising pairs first gives, right or wrong."""
    builder = Builder(_edges(proposals, standards), witness, standards)
    return builder.build(_alone(scans), None)


def configurations(
    scans: Sequence[int],
    proposals: Mapping[PairKey, Proposals],
    witness: Witness,
    standards: Standards,
) -> list[Configuration]:
    """The best configuration that is found, and after it others that are about as good.

    The same scans and proposals give the same ones.

    Args:
        scans: all of them.
        proposals: what pairs proposed.
        witness: asks scans about poses.
        standards: what a join must fulfil.
    """
    builder = Builder(_edges(proposals, standards), witness, standards)
    rng = np.random.default_rng(0)
    alone = _alone(scans)
    best = builder.build(alone, None)
    found = {_name(best, witness): best}
    for _ in range(FRESH):
        made = builder.build(alone, rng)
        found.setdefault(_name(made, builder.witness), made)
    while True:
        best = _improved(max(found.values(), key=_merit), builder, rng, found)
        for scan in scans:
            without = builder.following(best, scan)
            for _ in range(TRIES_ELSEWHERE):
                made = builder.build(_taken_apart(best, rng, scan), rng, without)
                found.setdefault(_name(made, builder.witness), made)
        if max(map(_merit, found.values())) <= best.merit + WORTH_GOING_ON:
            break
    best = max(found.values(), key=_merit)
    least = ABOUT_AS_GOOD * best.merit
    others = [one for one in found.values() if one is not best and one.merit >= least]
    return [best, *sorted(others, key=lambda one: -one.merit)]


def _improved(
    best: Configuration,
    builder: Builder,
    rng: np.random.Generator,
    found: dict[bytes, Configuration],
) -> Configuration:
    """A configuration from which nothing better was found for long; all on the way are kept."""
    current, idle = best, 0
    while idle < PATIENCE + PATIENCE_PER_SCAN * sum(map(len, best.poses)):
        made = builder.build(_taken_apart(current, rng), rng)
        found.setdefault(_name(made, builder.witness), made)
        idle = 0 if made.merit > best.merit + WORTH_GOING_ON else idle + 1
        if made.merit >= (1 - SLACK) * current.merit:
            current = made
        if made.merit > best.merit:
            best = made
    return best


def _alone(scans: Sequence[int]) -> Configuration:
    """No two scans joined."""
    return Configuration(tuple({scan: np.eye(4)} for scan in scans), {}, {})


def _merit(configuration: Configuration) -> float:
    return configuration.merit


class Builder:
    """Joins groups by the edges between them."""

    def __init__(self, edges: Edges, witness: Witness, standards: Standards) -> None:
        self._edges = edges
        self.witness = witness
        self._standards = standards

    def following(self, configuration: Configuration, scan: int) -> BoolArray:
        """(E,) the edges that put a scan where a configuration has it."""
        ends, witness = self._edges.ends, self.witness
        result = np.zeros(len(ends), dtype=bool)
        poses = next(one for one in configuration.poses if scan in one)
        for row in np.flatnonzero((ends == scan).any(axis=1)):
            target, source = ends[row]
            if target in poses and source in poses:
                T = invert(poses[target]) @ poses[source]
                both = np.stack([T, self._edges.T_target_source[row]])
                size_m = SAME_VOXELS * witness.voxel_size_m
                result[row] = leaders(both, witness.centres_m[source], size_m)[1] == 0
        return result

    def build(
        self,
        start: Configuration,
        rng: np.random.Generator | None,
        without: BoolArray | None = None,
    ) -> Configuration:
        """Join groups by the most promising edge first, as long as nothing objects.

        Args:
            start: what is joined already.
            rng: of the order, None for that of what is most promising.
            without: (E,) edges that are not taken.
        """
        poses = list(start.poses)
        of = np.zeros(1 + max(max(one) for one in poses), dtype=np.int64)
        for number, one in enumerate(poses):
            of[list(one)] = number
        shares, against, weight = dict(start.shares), dict(start.against), self._edges.weight
        if rng is not None:
            weight = weight * np.exp(SPREAD * rng.normal(size=len(weight)))
        ends = self._edges.ends
        is_across = of[ends[:, 0]] != of[ends[:, 1]]
        across = np.flatnonzero(is_across if without is None else is_across & ~without)
        for row in across[np.argsort(-weight[across], kind="stable")]:
            first, second = of[ends[row]]
            if first != second:
                found = self._joined(poses[first], poses[second], row)
                if found is not None:
                    moved, agree, contradict = found
                    poses[first] = {**poses[first], **moved}
                    of[list(moved)] = first
                    shares |= agree
                    against |= contradict
        left = tuple(poses[number] for number in np.unique(of[[s for one in poses for s in one]]))
        return Configuration(left, shares, against)

    def _joined(
        self, first: dict[int, FloatArray], second: dict[int, FloatArray], row: int
    ) -> tuple[dict[int, FloatArray], dict[PairKey, float], dict[PairKey, float]] | None:
        """The second group in the first's frame, what agrees across both and what contradicts; None
        if a scan objects, or hardly anything agrees."""
        target, source = self._edges.ends[row]
        T = first[target] @ self._edges.T_target_source[row] @ invert(second[source])
        moved = {scan: straightened(T @ pose) for scan, pose in second.items()}
        shares, against, excess, limit = {}, {}, 0.0, self._standards.limit
        for a, b, T_a_b in self.witness.meeting(first, moved):
            overlap, violation = self.witness.about(a, b, T_a_b)
            beyond = max(violation - STRAY_SHARE, 0.0)
            if beyond > limit or overlap > self._standards.most_overlap:
                return None
            excess += beyond
            if overlap > 0:
                shares[a, b] = overlap
            if violation > 0 and overlap >= MIN_OVERLAP:
                against[a, b] = violation / limit
        support = sum(shares.values())
        if support < MIN_SUPPORT or excess > limit * (support + LITTLE_OVERLAP):
            return None
        return moved, shares, against


def _edges(proposals: Mapping[PairKey, Proposals], standards: Standards) -> Edges:
    """The proposals in which something agrees and next to nothing contradicts."""
    ends: list[PairKey] = []
    T: list[FloatArray] = [np.zeros((0, 4, 4))]
    weight: list[float] = []
    for key, pair in sorted(proposals.items()):
        excess = np.maximum(pair.violation - STRAY_SHARE, 0.0)
        rows = (pair.overlap >= MIN_OVERLAP) & (pair.overlap <= standards.most_overlap)
        rows &= excess <= standards.limit
        ends += [key] * int(rows.sum())
        T.append(pair.T_target_source[rows])
        weight += (pair.overlap * np.exp(-pair.violation / standards.limit))[rows].tolist()
    stacked = np.array(ends, dtype=np.int64).reshape(-1, 2)
    return Edges(stacked, np.concatenate(T), np.array(weight))


def _taken_apart(
    configuration: Configuration, rng: np.random.Generator, middle: int | None = None
) -> Configuration:
    """Some scans alone, any or those about one; the others in the parts that hang together."""
    shares, scans = configuration.shares, sorted(s for one in configuration.poses for s in one)
    count = int(np.ceil(rng.uniform(FEWEST_OUT, MOST_OUT) * len(scans)))
    count = min(max(count, 2), MANY_OUT)
    likely = rng.random(len(scans))
    if middle is None and rng.random() < 0.5:
        middle = scans[int(rng.integers(len(scans)))]
    if middle is not None:  # those that share most with one scan
        for number, scan in enumerate(scans):
            key = min(scan, middle), max(scan, middle)
            likely[number] += 10 * shares.get(key, float(scan == middle))
    out = {scans[row] for row in np.argsort(-likely, kind="stable")[:count]}
    tied = [k for k, share in shares.items() if share >= MIN_OVERLAP and not out & set(k)]
    parts: list[dict[int, FloatArray]] = [{scan: np.eye(4)} for scan in sorted(out)]
    for one in configuration.poses:
        rest = sorted(set(one) - out)
        inside = [key for key in tied if key[0] in one]
        parts += [{scan: one[scan] for scan in part} for part in components(rest, inside)]
    part_of = {scan: number for number, part in enumerate(parts) for scan in part}

    def kept(of_pairs: dict[PairKey, float]) -> dict[PairKey, float]:
        """Those within a part."""
        return {k: value for k, value in of_pairs.items() if part_of[k[0]] == part_of[k[1]]}

    return Configuration(tuple(parts), kept(configuration.shares), kept(configuration.against))


def _name(configuration: Configuration, witness: Witness) -> bytes:
    """The same for configurations that hardly differ, for most of them."""
    name = []
    for poses in sorted(configuration.poses, key=min):
        scans = sorted(poses)
        first = invert(poses[scans[0]])
        for scan in scans:
            T = first @ poses[scan]
            moved_m = T[:3, :3] @ witness.centres_m[scan] + T[:3, 3]
            steps = moved_m / (SAME_VOXELS * witness.voxel_size_m), T[:3, :2].ravel() / _SAME_TURN
            name += [scan, *np.concatenate(steps).round().astype(int).tolist()]
        name.append(-1)
    return np.array(name, dtype=np.int32).tobytes()
