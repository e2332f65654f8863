"""From places to links: every pair of a group that overlaps is aligned finely, then balanced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from skipnet.projects.graph import Balance, Link, PairKey, Poses, balance, relative
from skipnet.projects.groups import Group
from skipnet.projects.witness import MIN_OVERLAP, Witness
from skipnet.registration.alignment.refinement import Refinement, refine
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray

ROUNDS = 2
"""Times that all overlaps are aligned, each from the poses that the last time led to."""
MAX_SHIFT_VOXELS = 1.5
"""Alignment that moves a pair farther has lost hold of it."""


def settled(
    group: Group, scans: Sequence[Scan], witness: Witness
) -> tuple[Balance, dict[PairKey, Link]]:
    """Final poses of a group's scans, and the links that they rest on.

    Every round aligns each overlapping pair by itself, from where the group puts it, and balances
    what comes out: a joint alignment over all overlaps, by way of their normal equations.
    """
    first = group.scans[0]
    T_first_group = np.linalg.inv(group.poses[first])
    poses: Poses = {scan: T_first_group @ group.poses[scan] for scan in group.scans}
    keys = overlapping(poses, witness)
    links: dict[PairKey, Link] = {}
    result = Balance(poses, {}, {})
    for _ in range(ROUNDS):
        links = {
            key: link
            for key in keys
            if (link := aligned(scans[key[1]], scans[key[0]], relative(poses, key))) is not None
        }
        result = balance(poses, links)
        poses = result.poses
    return result, links


def overlapping(poses: Mapping[int, FloatArray], witness: Witness) -> list[PairKey]:
    """The pairs of a group that see enough of the same."""
    return [
        key
        for key in combinations(sorted(poses), 2)
        if witness.pair(*key, relative(poses, key)[None])[0, 0] >= MIN_OVERLAP
    ]


def aligned(source: Scan, target: Scan, T_target_source: FloatArray) -> Link | None:
    """The link of a pair, aligned finely from a pose between the scans' own frames.

    Scans of few lines have no normals to align by at the fine level: their pose is kept, and what
    the middle level holds says how firmly. None where nothing holds them.
    """
    middle = (source.skipmap, target.skipmap)
    fine = (source.fine_skipmap, target.fine_skipmap)
    start = T_target_source[None]
    if source.is_sparse or target.is_sparse:
        found = refine(start, [middle], max_steps=1)
        return _link(found, T_target_source)
    found = refine(start, [middle, fine])
    centre_m = found.centre_m[0]
    moved_m = found.T_target_source[0] @ np.linalg.inv(T_target_source) @ np.append(centre_m, 1.0)
    if np.linalg.norm(moved_m[:3] - centre_m) > MAX_SHIFT_VOXELS * source.skipmap.voxel_size_m:
        return None
    return _link(found, found.T_target_source[0])


def _link(found: Refinement, T_target_source: FloatArray) -> Link | None:
    if found.matched[0] == 0:
        return None
    return Link(T_target_source, found.centre_m[0], found.information[0])
