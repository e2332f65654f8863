"""From places to links: every pair of a group that overlaps is aligned finely, then balanced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from skipnet.geometry import invert
from skipnet.projects.graph import Balance, Link, PairKey, Poses, balance, relative
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.witness import MIN_OVERLAP, Witness
from skipnet.registration.alignment.refinement import Refinement, apply, refine
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import FINE
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray

ROUNDS = 2
"""Times that all overlaps are aligned, each from the poses that the last time led to."""
MAX_SHIFT_VOXELS = 3.0
"""Alignment that moves a pair farther has lost hold of it."""
CLOSE = replace(FINE, max_distance_voxels=0.125)
"""How near surfaces are that agree closely."""


def settled(
    group: Group, scans: Sequence[Scan], joiner: Joiner
) -> tuple[Balance, dict[PairKey, Link]]:
    """Final poses of a group's scans, and the links that they rest on.

    Every round aligns each overlapping pair by itself, from where the group puts it, and balances
    what comes out: a joint alignment over all overlaps, by way of their normal equations.
    """
    first = group.scans[0]
    T_first_group = invert(group.poses[first])
    poses: Poses = {scan: T_first_group @ group.poses[scan] for scan in group.scans}
    keys = overlapping(poses, joiner.witness)
    links: dict[PairKey, Link] = {}
    result = Balance(poses, {}, {})
    for _ in range(ROUNDS):
        links = {
            key: link for key in keys if (link := _measured(key, poses, scans, joiner)) is not None
        }
        result = balance(poses, links)
        poses = result.poses
    return result, links


def _measured(key: PairKey, poses: Poses, scans: Sequence[Scan], joiner: Joiner) -> Link | None:
    target, source = key
    own = joiner.proposed(Group(poses), key)
    others = joiner.proposals[key].T_target_source[own] if own.any() else np.zeros((0, 4, 4))
    judge = joiner.witness.judge(*key)
    return aligned(scans[source], scans[target], relative(poses, key), others, judge)


def overlapping(poses: Mapping[int, FloatArray], witness: Witness) -> list[PairKey]:
    """The pairs of a group that see enough of the same."""
    return [
        key
        for key in combinations(sorted(poses), 2)
        if witness.pair(*key, relative(poses, key)[None])[0, 0] >= MIN_OVERLAP
    ]


def aligned(
    source: Scan, target: Scan, T_target_source: FloatArray, others: FloatArray, judge: Judge
) -> Link | None:
    """The link of a pair, aligned finely from a pose between the scans' own frames.

    What slides along a wall finds several places to rest: alignment starts from the pair's own
    proposals too, and the result in which most agrees closely is taken.

    Scans of few lines have no normals to align by at the fine level: their pose is kept, and what
    the middle level holds says how firmly. None where nothing holds them.

    Args:
        source: described source ...
        target: ... and target.
        T_target_source: (4, 4) where the group puts the source.
        others: (C, 4, 4) about the same, by the pair itself.
        judge: of both.
    """
    middle = (source.skipmap, target.skipmap)
    if source.is_sparse or target.is_sparse:
        found = refine(T_target_source[None], [middle], max_steps=1)
        return _link(found, 0, T_target_source)
    start = np.concatenate([T_target_source[None], others])
    found = refine(start, [middle, (source.fine_skipmap, target.fine_skipmap)])
    moved_m = found.T_target_source @ invert(T_target_source)
    moved_m = np.linalg.norm(apply(moved_m, found.centre_m) - found.centre_m, axis=1)
    close = judge.score(found.T_target_source, CLOSE).overlap
    close[moved_m > MAX_SHIFT_VOXELS * source.skipmap.voxel_size_m] = 0.0
    best = int(np.argmax(close))
    return None if close[best] == 0 else _link(found, best, found.T_target_source[best])


def _link(found: Refinement, row: int, T_target_source: FloatArray) -> Link | None:
    if found.matched[row] == 0:
        return None
    return Link(T_target_source, found.centre_m[row], found.information[row])
