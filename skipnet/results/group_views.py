"""Many scans in 3-D: a group as it was placed, where scans in doubt may stand, how they came."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skipnet.geometry import transform_points
from skipnet.results.inputs import Given
from skipnet.results.skipmaps import viewed_skipmap
from skipnet.results.views import moved_together
from skipnet.skipmap.tree import points_of
from skipnet.types import FloatArray, IntArray
from skipnet.viz.colours import scan_colour
from skipnet.viz.lengths import Lengths
from skipnet.viz.residuals import residuals_m
from skipnet.viz.viewed import ViewedPose, ViewedScan, some_rows
from skipnet.viz.viewer import MOST_POINTS, viewer

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly

_MOST_PLACES = 8
"""Of scans in doubt; each is a button."""


def group_viewer(
    scans: Sequence[Given], result: Assembly, lengths: Lengths, most: int = MOST_POINTS
) -> tuple[str, FloatArray]:
    """The view of the largest group, and the (N,) residuals of the points that it shows.

    Args:
        scans: all of them.
        result: of the registration.
        lengths: how to speak of them.
        most: points to show.
    """
    group = result.groups[0]
    shown = [*group, *_doubtful(result)]
    points_m = {scan: points_of(scans[scan].points_m) for scan in shown}
    rows = {scan: some_rows(points_m[scan], max(1, most // len(shown))) for scan in shown}
    thinned_m = {scan: points_m[scan][rows[scan]] for scan in shown}
    voxel_size_m = next(iter(result.pairs.values())).voxel_size_m
    placed_m = [transform_points(result.T_group_scan[scan], points_m[scan]) for scan in group]
    measured_m = residuals_m(placed_m, [rows[scan] for scan in group], voxel_size_m)
    away_m = dict(zip(group, measured_m, strict=True))
    viewed = [
        ViewedScan(
            f"{scan}: {Path(scans[scan].cloud.name).name}",
            thinned_m[scan],
            scan_colour(number),
            _colours(scans[scan], rows[scan]),
            away_m.get(scan),
            viewed_skipmap(result.described[scan]) if result.described else None,
        )
        for number, scan in enumerate(shown)
    ]
    poses = _poses(result, shown, thinned_m)
    view = viewer(viewed, poses, 0, voxel_size_m / 2, most, lengths=lengths)
    return view, np.concatenate(measured_m)


def _colours(scan: Given, rows: IntArray) -> IntArray | None:
    colour = None if scan.is_large else scan.cloud.colour_8bit
    return None if colour is None else colour[rows]


def _doubtful(result: Assembly) -> list[int]:
    """Scans that may stand somewhere in the largest group."""
    return [
        scan
        for scan, places in sorted(result.places.items())
        if any(place.group == 0 for place in places)
    ][:_MOST_PLACES]


def _poses(
    result: Assembly, shown: Sequence[int], scans_m: Mapping[int, FloatArray]
) -> list[ViewedPose]:
    """The group as it was placed; with each scan in doubt at each of its places; as they came."""
    group = result.groups[0]
    placed: dict[int, FloatArray | None] = dict.fromkeys(shown)
    placed |= {scan: result.T_group_scan[scan] for scan in group}
    note = "Every scan that found its place."
    if len(group) == 1:
        note = "One scan alone: no two were connected for sure."
    poses = [ViewedPose("placed", note, [placed[scan] for scan in shown])]
    for scan in shown[len(group) :]:
        places = [place for place in result.places[scan] if place.group == 0]
        for number, place in enumerate(places, 1):
            note = f"Scan {scan} is in doubt: place {number} of {len(places)} where it may stand."
            there = placed | {scan: place.T_group_scan}
            label = f"scan {scan}, place {number}"
            poses.append(ViewedPose(label, note, [there[one] for one in shown]))
    first_m = scans_m[shown[0]]
    came = [moved_together(scans_m[scan], first_m)[0] for scan in shown]
    far = any(T[:3, 3].any() for T in came)
    label = "as they came, moved together" if far else "as they came"
    return [*poses[: 1 + _MOST_PLACES], ViewedPose(label, "All scans as they came.", came)]
