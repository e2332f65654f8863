"""A second look at small things on a large plane: voxels that suit it are rough for them.

A table or a floor holds height and tilt; a cup on it all the rest, with a hundred voxels of ten
thousand. Where these leave the pose free to turn or slide, half the voxel size may hold it.
"""

from __future__ import annotations

from skipnet.registration.result import Registration
from skipnet.scans.scan import Scan
from skipnet.types import Status

MIN_PLANE_SHARE = 0.8
"""Of each scan's voxels, on its largest plane: where small things lie on a table it has this and
more; kitchens, terrains and clutter that leave a motion free have 0.7 at most, and half the voxel
size, which takes as long again, brought nothing there."""
MIN_SURE = 0.95
"""Confidence that a second look needs: by what one does in such voxels no share was fitted."""


def is_worth_it(result: Registration, source: Scan, target: Scan) -> bool:
    """Whether a pose that nothing contradicts is left free on a plane that is nearly all of both
    scans."""
    found = result.findings
    if result.status is not Status.AMBIGUOUS or found is None or found.is_sparse:
        return False
    is_free = len(found.free_directions) + len(found.free_turns) > 0
    return is_free and found.is_clean and min(map(_plane_share, (source, target))) > MIN_PLANE_SHARE


def is_sure(result: Registration) -> bool:
    """Whether what a second look found replaces the first answer."""
    found = result.findings
    is_registered = result.status is Status.REGISTERED and found is not None and found.is_clean
    return is_registered and result.confidence >= MIN_SURE


def _plane_share(scan: Scan) -> float:
    """Part of a scan's voxels on its largest plane."""
    return float(scan.planes.weights.max(initial=0.0)) / max(len(scan.skipmap), 1)
