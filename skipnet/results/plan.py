"""What the plan of a group shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skipnet.geometry import transform_points
from skipnet.results.inputs import Given
from skipnet.skipmap.tree import points_of
from skipnet.viz.plans import Plan, PlanLink

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly

FULL_WIDTH = 0.5
"""Overlap that is drawn as the thickest line."""


def plan_of(scans: Sequence[Given], result: Assembly, group: Sequence[int]) -> Plan:
    """One group from above, with the links that hold it and the pairs that it refutes."""
    poses = [result.T_group_scan[scan] for scan in group]
    return Plan(
        title=f"{len(group)} scans in the frame of scan {group[0]}",
        points_m=[
            transform_points(T, points_of(scans[scan].points_m))
            for scan, T in zip(group, poses, strict=True)
        ],
        origins_m=np.array([T[:3, 3] for T in poses]),
        labels=[str(scan) for scan in group],
        links=[*_links(result, group), *_refuted(result, group)],
    )


def _links(result: Assembly, group: Sequence[int]) -> list[PlanLink]:
    row = {scan: number for number, scan in enumerate(group)}
    return [
        PlanLink(
            row[target],
            row[source],
            min(link.overlap / FULL_WIDTH, 1.0),
            "0.3" if link.weight > 0 else "red",
        )
        for (target, source), link in result.links.items()
        if target in row and source in row
    ]


def _refuted(result: Assembly, group: Sequence[int]) -> list[PlanLink]:
    row = {scan: number for number, scan in enumerate(group)}
    return [
        PlanLink(row[target], row[source], 0.0, "tab:orange", ":")
        for (target, source), word in result.words.items()
        if word == "refuted" and target in row and source in row
    ]
