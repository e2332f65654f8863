"""Where does every scan stand? The configuration is sought in which most agrees.

Joins are made one by one, the most promising first, and an early wrong one keeps out right ones. So
this is done again and again, with joins in other orders, and from the best configuration so far of
which some scans were taken out. Nothing is believed here: of all that was found, that is best of
which most agrees, and what else was found nearly as good tells what is in doubt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.builder import Builder, edges_of
from skipnet.projects.components import components
from skipnet.projects.configurations import ALONE, Configuration, Found, Kept, all_alone
from skipnet.projects.groups import Proposals
from skipnet.projects.sameness import SAME_VOXELS
from skipnet.projects.ways import PairKey, Standards
from skipnet.projects.witness import MIN_OVERLAP, Witness
from skipnet.types import FloatArray

ATTEMPTS = 4
"""Searches that begin anew: what one of them does not come upon may be as good, or better."""
FRESH = 6
"""Configurations that are made from single scans at the start of each (of the first, beside the one
of the most promising joins first); the best of them is gone on from."""
PATIENCE = 60
"""So many attempts without a better one end the search, ..."""
PATIENCE_PER_SCAN = 3
"""... and so many for each scan."""
FEWEST_OUT, MOST_OUT = 0.1, 0.6
"""Least and largest share of the scans that is taken out, but no more scans than ..."""
MANY_OUT = 12
TRIES_ELSEWHERE = 4
"""Times that each scan is put elsewhere than where it stands best."""
WORTH_GOING_ON = 0.001
"""A configuration that is better by less is no reason to go on."""
_SAME_TURN = 0.2
"""Axes that differ by less are about the same, as far as a name goes."""
SLACK = 0.01
"""A configuration that is worse by this share is gone on from, too."""


def first_configuration(
    scans: Sequence[int],
    proposals: Mapping[PairKey, Proposals],
    witness: Witness,
    standards: Standards,
) -> Configuration:
    """What joining by the most promising pairs first gives, right or wrong."""
    builder = Builder(edges_of(proposals, witness, standards), witness, standards)
    return builder.build(all_alone(scans), None)


def configurations(
    scans: Sequence[int],
    proposals: Mapping[PairKey, Proposals],
    witness: Witness,
    standards: Standards,
    known: Kept | None = None,
) -> Kept:
    """The best configuration that is found, and after it others that are about as good.

    The same arguments give the same ones.

    Args:
        scans: all of them.
        proposals: what pairs proposed.
        witness: asks scans about poses.
        standards: what a join must fulfil.
        known: what was found by the same standards before some more was proposed, the best first;
            if there is anything, one search goes on from that.
    """
    builder = Builder(edges_of(proposals, witness, standards), witness, standards)
    rng, alone = np.random.default_rng(0), all_alone(scans)
    found = Found(partial(_name, witness), known or Kept())
    if known:
        _search(builder.build(known[0], None), builder, rng, found)
    starts = [] if known else [builder.build(alone, None)]
    for _ in range(0 if known else ATTEMPTS):
        starts += [builder.build(alone, rng) for _ in range(FRESH)]
        _search(max(starts, key=_merit), builder, rng, found)
        starts = []
    return found.ranked


def _search(
    best: Configuration,
    builder: Builder,
    rng: np.random.Generator,
    found: Found,
) -> None:
    """Go on from a configuration until nothing better comes, every scan put elsewhere too; all on
    the way are kept."""
    reached = -np.inf
    while best.merit > reached + WORTH_GOING_ON:
        best = _improved(best, builder, rng, found)
        reached = best.merit
        for scan in sorted(scan for one in best.poses for scan in one):
            without = builder.following(best, scan)
            others = [
                builder.build(_taken_apart(best, rng, scan), rng, without)
                for _ in range(TRIES_ELSEWHERE)
            ]
            for made in others:
                found.add(made)
            best = max([best, *others], key=_merit)


def _improved(
    best: Configuration,
    builder: Builder,
    rng: np.random.Generator,
    found: Found,
) -> Configuration:
    """A configuration from which nothing better was found for long; all on the way are kept."""
    current, idle = best, 0
    found.add(best)
    while idle < PATIENCE + PATIENCE_PER_SCAN * sum(map(len, best.poses)):
        made = builder.build(_taken_apart(current, rng), rng)
        found.add(made)
        idle = 0 if made.merit > best.merit + WORTH_GOING_ON else idle + 1
        if made.merit >= (1 - SLACK) * current.merit:
            current = made
        if made.merit > best.merit:
            best = made
    return best


def _merit(configuration: Configuration) -> float:
    return configuration.merit


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
    parts: list[dict[int, FloatArray]] = [{scan: ALONE} for scan in sorted(out)]
    for one in configuration.poses:
        rest = sorted(set(one) - out)
        inside = [key for key in tied if key[0] in one]
        parts += [{scan: one[scan] for scan in part} for part in components(rest, inside)]
    part_of = {scan: number for number, part in enumerate(parts) for scan in part}

    def kept(of_pairs: dict[PairKey, float]) -> dict[PairKey, float]:
        """Those within a part."""
        return {k: value for k, value in of_pairs.items() if part_of[k[0]] == part_of[k[1]]}

    return Configuration(tuple(parts), kept(configuration.shares), kept(configuration.against))


def _name(witness: Witness, configuration: Configuration) -> bytes:
    """The same for configurations that hardly differ, for most of them."""
    name: list[FloatArray] = []
    centres_m = np.asarray(witness.centres_m)
    for poses in sorted(configuration.poses, key=min):
        scans = sorted(poses)
        T = np.array([poses[scan] for scan in scans])
        T = invert(T[0]) @ T
        moved_m = np.squeeze(T[:, :3, :3] @ centres_m[scans][..., None], -1) + T[:, :3, 3]
        turns = T[:, :3, :2].reshape(-1, 6) / _SAME_TURN
        steps = np.hstack([moved_m / (SAME_VOXELS * witness.voxel_size_m), turns]).round()
        name += [np.column_stack([scans, steps]).ravel(), np.array([-1.0])]
    return np.concatenate(name).astype(np.int32).tobytes()
