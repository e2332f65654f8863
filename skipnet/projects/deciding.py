"""From decided groups to the result: final poses, a word on each pair, places of doubtful scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.arbiter import Arbiter, Known
from skipnet.projects.assembly import Assembly, FinalLink, Place, Word, deviation, numbered
from skipnet.projects.decision import Decision
from skipnet.projects.graph import Balance, Link, closure_m, relative
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.links import settled
from skipnet.projects.peculiarities import Peculiarities
from skipnet.projects.schedule import Outcome, all_proposals, best
from skipnet.projects.ways import PairKey
from skipnet.projects.witness import Witness
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status


def decide(
    outcomes: Mapping[PairKey, Sequence[Outcome]],
    scans: Sequence[Scan],
    witness: Witness,
    known: Known | None = None,
) -> tuple[Joiner, Decision]:
    """What pairs propose, and the groups that come of it.

    Args:
        outcomes: of every pair that counts.
        scans: all scans.
        witness: asks them about poses.
        known: what was found of the same scans when less was proposed; what is found now is added.
    """
    joiner = Joiner(all_proposals(outcomes, scans, witness), witness)

    def settle(group: Group) -> Group:
        return replace(group, poses=settled(group, scans, joiner)[0].poses)

    telling = Peculiarities(scans, joiner).agreeing
    return joiner, Arbiter(joiner, settle, telling, known).decide(range(len(scans)))


def assemble(
    decision: Decision,
    joiner: Joiner,
    outcomes: Mapping[PairKey, Sequence[Outcome]],
    scans: Sequence[Scan],
    timings_s: dict[str, float],
) -> Assembly:
    """The result from decided groups: every group is aligned jointly.

    Args:
        decision: groups, and what is in doubt.
        joiner: knows what pairs proposed.
        outcomes: of every pair that was searched.
        scans: all scans.
        timings_s: so far; the dictionary is kept.
    """
    groups = [group.scans for group in decision.groups]
    balances = [settled(group, scans, joiner) for group in decision.groups]
    T_group_scan: list[FloatArray] = [np.eye(4)] * len(scans)
    deviations = [(0.0, 0.0)] * len(scans)
    links: dict[PairKey, FinalLink] = {}
    for group, (balance, measured) in zip(decision.groups, balances, strict=True):
        first = scans[group.scans[0]]
        for scan, T in balance.poses.items():
            T_group_scan[scan] = first.T_given_own @ T @ invert(scans[scan].T_given_own)
            deviations[scan] = deviation(balance.covariances.get(scan, np.zeros((6, 6))))
        T_group_scan[group.scans[0]] = np.eye(4)
        links |= _final_links(balance, measured, joiner.witness)
    return Assembly(
        groups=groups,
        T_group_scan=T_group_scan,
        status=_statuses(groups, len(scans)),
        pairs={key: best(found) for key, found in outcomes.items()},
        words=_words(decision.groups, joiner),
        links=links,
        places=_places(decision, balances, scans),
        position_std_m=[position_m for _, position_m in deviations],
        rotation_std_rad=[rotation_rad for rotation_rad, _ in deviations],
        reliability=decision.reliability,
        timings_s=timings_s,
    )


def _statuses(groups: Sequence[Sequence[int]], count: int) -> list[Status]:
    lone = {group[0] for group in groups if len(group) == 1}
    return [Status.AMBIGUOUS if scan in lone else Status.REGISTERED for scan in range(count)]


def _final_links(
    balance: Balance, measured: Mapping[PairKey, Link], witness: Witness
) -> dict[PairKey, FinalLink]:
    found = {}
    for key, link in measured.items():
        overlap, violation = witness.pair(*key, relative(balance.poses, key)[None])[:, 0]
        found[key] = FinalLink(
            float(overlap),
            float(violation),
            closure_m(link, key, balance.poses),
            balance.weights.get(key, 1.0),
        )
    return found


def _words(groups: Sequence[Group], joiner: Joiner) -> dict[PairKey, Word]:
    number = numbered([group.scans for group in groups])
    words = {}
    for key, pair in joiner.proposals.items():
        if pair.confidence == 0:
            words[key] = Word.NONE
        elif number[key[0]] != number[key[1]]:
            words[key] = Word.OPEN
        else:
            holds = joiner.proposed(groups[number[key[0]]], key)[0]
            words[key] = Word.HOLDS if holds else Word.REFUTED
    return words


def _places(
    decision: Decision,
    balances: Sequence[tuple[Balance, Mapping[PairKey, Link]]],
    scans: Sequence[Scan],
) -> dict[int, list[Place]]:
    """Where doubtful scans may stand, in the frames of the result."""
    number = numbered([group.scans for group in decision.groups])
    found = {}
    for scan, options in decision.places.items():
        host = number[decision.host[scan]]
        first = decision.groups[host].scans[0]
        T_first_group = invert(decision.groups[host].poses[first])
        found[scan] = [
            Place(host, between_given(scans[first], T_first_group @ T, scans[scan]))
            for T in options
        ]
    return found


def between_given(first: Scan, T_first_scan: FloatArray, scan: Scan) -> FloatArray:
    """(4, 4) between the frames that two scans were given in, of one between their own."""
    T: FloatArray = first.T_given_own @ T_first_scan @ invert(scan.T_given_own)
    return T
