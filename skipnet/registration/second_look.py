"""A second look where the voxels may be too rough: half their size may hold a pose, or tell it.

A table or a floor holds height and tilt; a cup on it all the rest, with a hundred voxels of ten
thousand. A bowl lies on itself however it is turned, but for its handles.
"""

from __future__ import annotations

import numpy as np

from skipnet.registration.result import Registration
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status

MIN_PLANE_SHARE = 0.8
"""Of each scan's voxels, on its largest plane: where small things lie on a table it has this and
more; kitchens, terrains and clutter that are ambiguous have 0.7 at most."""
MIN_SURE = 0.95
"""Confidence that a second look needs: by what one does in such voxels no share was fitted."""


def is_worth_it(result: Registration, source: Scan, target: Scan) -> bool:
    """Whether a pose that nothing contradicts is in doubt for small things alone."""
    found = result.findings
    if result.status is not Status.AMBIGUOUS or found is None or found.is_sparse:
        return False
    if found.is_blind or not found.is_clean:
        return False
    return found.lies_on_itself or min(map(_plane_share, (source, target))) > MIN_PLANE_SHARE


def poses_in_doubt(result: Registration) -> FloatArray:
    """(K, 4, 4) between which the first look could not decide: a second one has to say what tells
    them from its own."""
    found = result.findings
    others = np.zeros((0, 4, 4)) if found is None else found.alternatives
    return np.concatenate([result.T_target_source[None], others])


def is_sure(result: Registration) -> bool:
    """Whether what a second look found replaces the first answer."""
    found = result.findings
    is_registered = result.status is Status.REGISTERED and found is not None and found.is_clean
    return is_registered and result.confidence >= MIN_SURE


def _plane_share(scan: Scan) -> float:
    """Part of a scan's voxels on its largest plane."""
    return float(scan.planes.weights.max(initial=0.0)) / max(len(scan.skipmap), 1)
