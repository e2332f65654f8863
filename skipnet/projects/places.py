"""Where else a scan of a group might stand."""

from __future__ import annotations

import numpy as np

from skipnet.projects.groups import SAME_VOXELS, Group, Joiner
from skipnet.projects.ways import Way
from skipnet.projects.witness import leaders


def places(group: Group, scan: int, joiner: Joiner) -> tuple[Way, list[Way]]:
    """Where a scan stands among the others of its group, and where else it might."""
    rest, alone = group.without(scan), Group.single(scan)
    T = group.poses[scan]
    said = joiner.witness.all_pairs(rest.poses, alone.poses, T[None])
    ways = joiner.ways(rest, alone)
    stack = np.concatenate([T[None], *(way.T[None] for way in ways)])
    witness = joiner.witness
    size_m = SAME_VOXELS * witness.voxel_size_m
    is_here = leaders(stack, witness.centres_m[scan], size_m)[1:] == 0
    here = Way(
        T,
        joiner.voters(group, scan),
        0.0,
        float(said.support[0]),
        float(said.contradiction[0]),
        int(said.witnesses[0]),
        float(said.closest[0]),
    )
    return here, [way for way, same in zip(ways, is_here, strict=True) if not same]
