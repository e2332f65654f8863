"""All situations by name, and what counts as right in them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skipnet.geometry import transform_points
from skipnet.simulation.situations.making import Situation
from skipnet.simulation.situations.mapped import mapped
from skipnet.simulation.situations.moving import hall, riding
from skipnet.simulation.situations.objects import arch, part, table
from skipnet.simulation.situations.repeating import pedestal, row
from skipnet.simulation.situations.surfaces import ground, model, tank
from skipnet.types import FloatArray

SITUATIONS: dict[str, Callable[[int], Situation]] = {
    "riding": riding,
    "arch": arch,
    "part": part,
    "table": table,
    "hall": hall,
    "model": model,
    "map": mapped,
    "ground": ground,
    "tank": tank,
    "row": row,
    "pedestal": pedestal,
}
"""Each makes the situation number ``seed`` of its kind; the same seed gives the same bits."""
MAX_ERROR = 0.01
"""A pose is right that puts the source's points this near, as a share of the source's extent."""
_ASKED = 4000


def is_right(T_target_source: FloatArray, situation: Situation) -> bool:
    """Whether a (4, 4) pose brings the source to its place; never so where it has none."""
    if situation.T_target_source is None:
        return False
    points_m = situation.source_m[:: max(1, len(situation.source_m) // _ASKED)]
    there_m, truly_m = (
        transform_points(T, points_m) for T in (T_target_source, situation.T_target_source)
    )
    extent_m = np.linalg.norm(np.ptp(points_m, axis=0))
    error_m = np.sqrt(((there_m - truly_m) ** 2).sum(axis=1).mean())
    return bool(error_m < MAX_ERROR * extent_m)
