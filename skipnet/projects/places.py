"""Where else a scan of a group might stand."""

from __future__ import annotations

from skipnet.projects.groups import Group, Joiner
from skipnet.projects.sameness import same_place
from skipnet.projects.ways import Way


def places(group: Group, scan: int, joiner: Joiner) -> tuple[Way, list[Way]]:
    """Where a scan stands among the others of its group, and where else it might."""
    rest, alone = group.without(scan), Group.single(scan)
    T = group.poses[scan]
    said = joiner.witness.all_pairs(rest.poses, alone.poses, T[None])
    ways = joiner.ways(rest, alone)
    here = Way(
        T,
        joiner.voters(group, scan),
        0.0,
        float(said.support[0]),
        float(said.contradiction[0]),
        int(said.witnesses[0]),
        float(said.closest[0]),
    )
    return here, [way for way in ways if not same_place(joiner.witness, scan, T, way.T)]
