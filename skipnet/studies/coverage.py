"""Is the truth where the stated covariance says? The second table of ``skipnet study accuracy``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from skipnet.geometry import invert
from skipnet.registration.pipeline import register
from skipnet.registration.result import Registration
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.types import FloatArray, Status
from skipnet.viz.tables import Table


class Stated(NamedTuple):
    """How a scene is scanned, and what becomes of the scans."""

    family: str
    scanner: str = "terrestrial"
    lattice_m: float = 0.0
    """Both scans rounded to a lattice of this edge, one point for each place; 0 as they are."""


STATED = {
    "paper room": Stated("paper_room"),
    "oblique": Stated("oblique"),
    "doorway": Stated("doorway"),
    "curved": Stated("curved"),
    "facade": Stated("facade"),
    "clutter": Stated("clutter"),
    "rings": Stated("paper_room", "rings"),
    "rings, oblique rooms": Stated("oblique", "rings"),
    "lattice of 20 mm": Stated("paper_room", lattice_m=0.02),
    "lattice of 35 mm, oblique": Stated("oblique", lattice_m=0.035),
    "lattice of 50 mm, oblique": Stated("oblique", lattice_m=0.05),
}
LIMIT = 10.6446
"""Of six squared standard deviations: 90 % of a chi-square distribution lie below."""


def try_stated(job: tuple[str, int]) -> dict[str, Any]:
    """Register one pair of ``STATED``; its status and how far the truth is off, as a chi-square."""
    name, seed = job
    family, scanner, lattice_m = STATED[name]
    simulated = simulate_pair(family, seed, scanner=scanner, rotation="any")
    scans_m = [simulated.pair.source_m, simulated.pair.target_m]
    if lattice_m:
        scans_m = [np.unique(np.round(p / lattice_m), axis=0) * lattice_m for p in scans_m]
    found = register(*scans_m)
    squares = squared_deviations(found, simulated.T_target_source) if found.findings else 0.0
    return {"status": str(found.status), "squares": squares}


def squared_deviations(found: Registration, truth: FloatArray) -> float:
    """Squared Mahalanobis distance of the (4, 4) truth from the answer, by its covariance."""
    from scipy.spatial.transform import Rotation

    assert found.findings is not None
    centre_m = found.findings.covariance_centre_m
    off = found.T_target_source @ invert(truth)
    shift_m = off[:3, :3] @ centre_m + off[:3, 3] - centre_m
    error = np.concatenate([Rotation.from_matrix(off[:3, :3]).as_rotvec(), shift_m])
    return float(error @ np.linalg.solve(found.findings.covariance, error))


def coverage_table(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """One row per kind: of the registered pairs, how many ellipsoids hold the truth."""
    rows = []
    for name, outcomes in found.items():
        squares = [one["squares"] for one in outcomes if one["status"] == Status.REGISTERED.value]
        inside = int((np.array(squares) < LIMIT).sum())
        share = f"{inside / len(squares):.0%}" if squares else "–"
        rows.append((name, str(len(outcomes)), str(len(squares)), str(inside), share))
    headers = ("", "pairs", "registered", "truth in the 90 % ellipsoid", "share")
    return Table("Stated covariance", headers, tuple(rows), "Of rotation and position together.")
