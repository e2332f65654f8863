"""The same pairs under worse conditions: noisier, sparser, with less overlap."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.options import DisturbanceConfig
from skipnet.geometry import transform_points
from skipnet.simulation.scanning.degrading import add_passers_by, cut, shake, thin
from skipnet.types import Pair


def disturbed_pairs(pair_set: PairSet, disturbances: Sequence[DisturbanceConfig]) -> PairSet:
    """Every pair once with each disturbance; without disturbances the same set.

    The disturbance's name ends the names of the pair and of its set, so that each condition is a
    column in a table of sets.
    """
    if not disturbances:
        return pair_set
    plan = [(i, one) for one in disturbances for i in range(len(pair_set))]
    names = tuple(f"{pair_set.names[i]}, {one.name}" for i, one in plan)

    def load(index: int) -> Pair:
        """The pair of that index, disturbed as planned."""
        i, one = plan[index]
        pair = disturb(pair_set.load(i), one)
        return replace(pair, name=names[index], set_name=f"{pair.set_name}, {one.name}")

    return PairSet(names, load)


def disturb(pair: Pair, how: DisturbanceConfig) -> Pair:
    """The pair with both scans made worse; the truth stays.

    Args:
        pair: its name seeds every draw, so all methods see the same.
        how: passers-by come first, then cropping (by planes of random direction, the source on one
            side and the target on the other; the overlap is then unknown), thinning and noise.
    """
    rng = np.random.default_rng([1, zlib.crc32(pair.name.encode())])
    source_m, target_m = pair.source_m, pair.target_m
    if how.passers_by > 0:
        source_m, target_m = (add_passers_by(p, how.passers_by, rng) for p in (source_m, target_m))
    if how.crop > 0:
        direction = rng.standard_normal(3)
        source_in_target_m = transform_points(pair.T_target_source, source_m)
        source_m = cut(source_m, source_in_target_m @ direction, how.crop)
        target_m = cut(target_m, target_m @ -direction, how.crop)
    if how.keep < 1:
        source_m, target_m = (thin(p, how.keep, how.keep, rng) for p in (source_m, target_m))
    if how.noise_m > 0:
        source_m, target_m = (shake(p, how.noise_m, rng) for p in (source_m, target_m))
    overlap = pair.overlap if how.crop == 0 else None
    return replace(pair, source_m=source_m, target_m=target_m, overlap=overlap)
