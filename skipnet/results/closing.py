"""What a command says when it has finished: a few rows of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skipnet.registration.result import Registration
from skipnet.types import FloatArray
from skipnet.viz.lengths import Lengths

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly


def closing_rows(
    result: Registration, residuals_m: FloatArray, lengths: Lengths, written: Sequence[str]
) -> list[tuple[str, str]]:
    """Verdict, overlap, residual, uncertainty, times and files of a pair.

    Args:
        result: of the registration.
        residuals_m: (N,) distances of the source's points from the target.
        lengths: how to speak of them.
        written: names of files.
    """
    found = result.findings
    near_m = residuals_m[residuals_m < result.voxel_size_m]
    rows = [("verdict", f"{result.status}, confidence {result.confidence:.2f}")]
    if found is not None:
        turn_deg = math.degrees(found.rotation_std_rad)
        rows.append(("overlap", f"{found.overlap:.0%} of the surfaces"))
        if len(near_m):
            median = lengths.small(float(np.median(near_m)))
            rows.append(("residual", f"{median} to the nearest point, median of the overlap"))
        off = f"{lengths.small(found.position_std_m)} and {turn_deg:.2g} deg"
        rows.append(("uncertainty", f"{off}, if the pose is right"))
    return [*rows, ("time", _times(result.timings_s)), ("files", ", ".join(written))]


def many_rows(result: Assembly, lengths: Lengths, written: Sequence[str]) -> list[tuple[str, str]]:
    """Verdict, groups, uncertainty, times and files of many scans."""
    placed = [scan for group in result.groups if len(group) > 1 for scan in group]
    sizes = ", ".join(str(len(group)) for group in result.groups)
    rows = [("verdict", f"{result.outcome}, groups of {sizes} scans")]
    if placed:
        worst_m = max(result.position_std_m[scan] for scan in placed)
        worst_deg = math.degrees(max(result.rotation_std_rad[scan] for scan in placed))
        off = f"{lengths.small(worst_m)} and {worst_deg:.2g} deg"
        rows.append(("uncertainty", f"{off} at most, against the first of its group"))
    return [*rows, ("time", _times(result.timings_s)), ("files", ", ".join(written))]


def _times(timings_s: dict[str, float]) -> str:
    """The sum, and the stages that take most of it."""
    total_s = sum(timings_s.values())
    longest = sorted(timings_s.items(), key=lambda stage: -stage[1])[:3]
    stages = ", ".join(f"{name} {time_s:.1f}" for name, time_s in longest if time_s >= 0.05)
    return f"{total_s:.1f} s" + (f" ({stages})" if stages else "")
