"""Which work is to be done: one search per pair, kept when it is done, asked for only once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.groups import Proposals
from skipnet.projects.sameness import leaders
from skipnet.projects.ways import PairKey
from skipnet.projects.witness import Witness
from skipnet.registration.generators import propose
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import ROUGH
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.pipeline import register_with_finalists
from skipnet.registration.prior import Prior
from skipnet.registration.result import Registration
from skipnet.registration.stopwatch import Stopwatch
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status

CHEAP = (Generator.planes,)
"""Asked about every pair; the others only where groups are still apart."""
DISTINCT_VOXELS = 2.0
"""Proposals that put the source closer together than this are one."""


@dataclass(frozen=True)
class Outcome:
    """What one search of one pair found."""

    result: Registration
    finalists: FloatArray
    """(K, 4, 4) between the frames that the scans were given in, distinct poses, best first."""


def cheap(config: RegistrationConfig) -> RegistrationConfig:
    """What every pair is asked: the cheap generators, or all where none of them is chosen."""
    chosen = [generator for generator in config.generators if generator in CHEAP]
    return replace(config, generators=chosen or config.generators)


def costly(config: RegistrationConfig) -> RegistrationConfig | None:
    """What pairs are asked that are still apart; None where nothing is left to ask."""
    rest = [generator for generator in config.generators if generator not in CHEAP]
    if not rest or len(rest) == len(config.generators):
        return None
    return replace(config, generators=rest)


def search(
    source: Scan, target: Scan, config: RegistrationConfig, prior: Prior | None = None
) -> Outcome:
    """Register one pair. Neither other pairs nor the order of work change what it finds."""
    return Outcome(*register_with_finalists(source, target, config, Stopwatch(), prior))


def promise(source: Scan, target: Scan, config: RegistrationConfig) -> float:
    """How much agrees, at a glance, in the best candidate of a pair before it is aligned.

    Where a floor's rooms are alike the likeness of descriptors says no more than chance about who
    overlaps with whom, and this says a lot: of the pairs that share a tenth it ranks 97 % among the
    first 15 of 24 (one simulated floor).
    """
    moving, fixed = sorted((source, target), key=lambda scan: scan.rank)
    if min(len(moving.skipmap), len(fixed.skipmap)) == 0:
        return 0.0
    of_moving, of_fixed = (scan.valued_evidence(config.feature_weight) for scan in (moving, fixed))
    judge = Judge(of_moving, of_fixed, config.final_samples, config.violation_weight)
    hypotheses = propose(config.generators[0], moving, fixed, config)
    best = judge.shortlist(hypotheses.T_target_source)[:1]
    return float(judge.score(best, ROUGH).total.max(initial=0.0))


def proposals(
    outcomes: Sequence[Outcome], key: PairKey, scans: Sequence[Scan], witness: Witness
) -> Proposals:
    """What the searches of one pair propose, the answer first."""
    target, source = (scans[number] for number in key)
    answer = best(outcomes)
    stack = np.concatenate(
        [answer.T_target_source[None], *(outcome.finalists for outcome in outcomes)]
    )
    T = invert(target.T_given_own) @ stack @ source.T_given_own
    far_m = DISTINCT_VOXELS * witness.voxel_size_m
    T = T[np.unique(leaders(T, witness.centres_m[key[1]], far_m))]
    overlap, violation = witness.pair(*key, T)
    is_sure = answer.status is Status.REGISTERED
    return Proposals(T, overlap, violation, answer.confidence if is_sure else 0.0)


def best(outcomes: Sequence[Outcome]) -> Registration:
    """The registered answer of most confidence; else the first."""
    results = [outcome.result for outcome in outcomes]
    return max(results, key=lambda one: (one.status is Status.REGISTERED) * one.confidence)


def all_proposals(
    outcomes: Mapping[PairKey, Sequence[Outcome]], scans: Sequence[Scan], witness: Witness
) -> dict[PairKey, Proposals]:
    """Of every pair that was searched."""
    return {key: proposals(outcomes[key], key, scans, witness) for key in sorted(outcomes)}
