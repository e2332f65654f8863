"""What a change of the scans may not change: ``skipnet study invariants``.

Some changes leave every right answer right: which scan is the source, where a scan stood before,
the order of its points, each point twice, a stray. Others take something away, and a refusal is an
honest answer to them. None may bring a wrong pose that is called registered.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.disturbed import disturb
from skipnet.benchmark.datasets.listed import FOLDER
from skipnet.benchmark.options import DisturbanceConfig
from skipnet.geometry import (
    invert,
    make_transform,
    pose_error,
    random_rotation,
    transform_points,
)
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import INVARIANTS
from skipnet.studies.options import InvariantsConfig
from skipnet.studies.study import do_all, report
from skipnet.types import FloatArray, Pair
from skipnet.viz.tables import Table

FAMILIES = ("paper_room", "closed", "oblique", "doorway")
POINTS = 40_000
CLUTTER_SHARE, CLUTTER_WIDTHS = 0.05, 3.0
STRAY_M = 1e6
SCALE = 2.0

Change = Callable[[Pair, np.random.Generator], Pair]


def swap(pair: Pair, rng: np.random.Generator) -> Pair:
    """The other scan is the source."""
    return replace(
        pair,
        source_m=pair.target_m,
        target_m=pair.source_m,
        source_viewpoint_m=pair.target_viewpoint_m,
        target_viewpoint_m=pair.source_viewpoint_m,
        T_target_source=invert(pair.T_target_source),
    )


def move(pair: Pair, rng: np.random.Generator) -> Pair:
    """Both scans come in other frames, turned at will and some ten metres away."""
    T_source, T_target = (
        make_transform(random_rotation(rng), rng.uniform(-30, 30, 3)) for _ in range(2)
    )
    return replace(
        pair,
        source_m=transform_points(T_source, pair.source_m),
        target_m=transform_points(T_target, pair.target_m),
        source_viewpoint_m=_moved(T_source, pair.source_viewpoint_m),
        target_viewpoint_m=_moved(T_target, pair.target_viewpoint_m),
        T_target_source=T_target @ pair.T_target_source @ invert(T_source),
    )


def _moved(T: FloatArray, place_m: FloatArray | None) -> FloatArray | None:
    return None if place_m is None else transform_points(T, np.atleast_2d(place_m))[0]


def forget(pair: Pair, rng: np.random.Generator) -> Pair:
    """As ``move``, and nobody knows where the sensors stood: less speaks against a pose."""
    return replace(move(pair, rng), source_viewpoint_m=None, target_viewpoint_m=None)


def scale(pair: Pair, rng: np.random.Generator) -> Pair:
    """All is twice as large, the limits too."""
    T = np.array(pair.T_target_source)
    T[:3, 3] *= SCALE
    source_viewpoint_m, target_viewpoint_m = (
        None if place_m is None else SCALE * place_m
        for place_m in (pair.source_viewpoint_m, pair.target_viewpoint_m)
    )
    larger = replace(
        pair,
        T_target_source=T,
        success_translation_m=pair.success_translation_m * SCALE,
        source_viewpoint_m=source_viewpoint_m,
        target_viewpoint_m=target_viewpoint_m,
    )
    return _both(larger, lambda points_m: points_m * SCALE)


def clutter(points_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Some per cent of further points, anywhere in a space a few times as wide as the scan."""
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    reach_m = CLUTTER_WIDTHS * (high_m - low_m).max() / 2
    count = int(CLUTTER_SHARE * len(points_m))
    far_m = (low_m + high_m) / 2 + rng.uniform(-reach_m, reach_m, (count, 3))
    return np.concatenate([points_m, far_m])


def _both(pair: Pair, change: Callable[[FloatArray], FloatArray]) -> Pair:
    source_m, target_m = (change(np.asarray(p, np.float64)) for p in (pair.source_m, pair.target_m))
    return replace(pair, source_m=source_m, target_m=target_m)


def _of_points(change: Callable[[FloatArray, np.random.Generator], FloatArray]) -> Change:
    return lambda pair, rng: _both(pair, lambda points_m: change(points_m, rng))


def _disturbed(**how: Any) -> Change:
    return lambda pair, rng: disturb(pair, DisturbanceConfig(**how))


CHANGES: dict[str, Change] = {
    "as it came": lambda pair, rng: pair,
    "swapped": swap,
    "moved before": move,
    "moved, sensors forgotten": forget,
    "other order": _of_points(lambda points_m, rng: rng.permutation(points_m)),
    "every point twice": _of_points(lambda points_m, rng: np.repeat(points_m, 2, axis=0)),
    "twice as large": scale,
    "one stray at 1000 km": _of_points(
        lambda points_m, rng: np.concatenate([points_m, [[STRAY_M, 0, 0]]])
    ),
    "5 % far clutter": _of_points(clutter),
    "half of the points": _disturbed(name="thin", keep=0.5),
    "5 mm noise": _disturbed(name="noise", noise_m=0.005),
    "a fifth cut off each": _disturbed(name="crop", crop=0.2),
}
"""By what the table calls them."""


@dataclass(frozen=True)
class Case:
    """A pair and what is done to it."""

    pair: Callable[[], Pair]
    change: str
    name: str


def run(config: InvariantsConfig) -> dict[str, Any]:
    """Change every pair in every way, register it and report; the summary comes back."""
    pairs: dict[str, Callable[[], Pair]] = {
        f"{family}/{seed}": partial(simulated, family, seed)
        for family in FAMILIES
        for seed in INVARIANTS.take(config.pairs, config.seed)
    }
    if config.data is not None:
        names = FOLDER.pairs(config.data, most_per_set=config.most_per_set).names
        limits = config.data, config.most_per_set
        pairs |= {name: partial(listed, *limits, index) for index, name in enumerate(names)}
    jobs = {
        f"{name}: {change}": Case(pair, change, name)
        for name, pair in pairs.items()
        for change in CHANGES
    }
    found = do_all(jobs, try_case, Path(config.output_dir), config.workers)
    counts: dict[str, Counter[str]] = {change: Counter() for change in CHANGES}
    for case, outcome in zip(jobs.values(), found, strict=True):
        counts[case.change][outcome["outcome"]] += 1
    kinds = ("right", "refused, though right", "refused", "wrong")
    rows = [
        (change, str(of.total()), *(str(of[kind]) for kind in kinds))
        for change, of in counts.items()
    ]
    heads = ("change", "pairs", "registered, right", "refused, pose right", "refused, pose wrong",
             "registered, wrong")  # fmt: skip
    return report(
        config,
        "Invariants: what may a change of the scans change?",
        {"pairs": f"{config.pairs} of each of {', '.join(FAMILIES)}; {config.data or 'no'} folder"},
        [Table("What became of the pairs", heads, tuple(rows))],
        outcomes={change: dict(of) for change, of in counts.items()},
    )


def simulated(family: str, seed: int) -> Pair:
    """A pair of a scene that nothing was chosen on."""
    return simulate_pair(family, seed, points=POINTS, rotation="any").pair


def listed(folder: str, most_per_set: int | None, index: int) -> Pair:
    """A pair of a folder."""
    return FOLDER.pairs(folder, most_per_set=most_per_set).load(index)


def try_case(case: Case) -> dict[str, Any]:
    """What the registration of a changed pair comes to."""
    rng = np.random.default_rng(zlib.crc32(f"{case.name}{case.change}".encode()))
    return outcome_of(CHANGES[case.change](case.pair(), rng))


def outcome_of(pair: Pair) -> dict[str, Any]:
    """ "right" or "wrong" where it is registered, "refused, though right" or "refused" else, and by
    how much the pose errs: the shift at the middle of the source, so that a frame that begins far
    away adds nothing."""
    source_viewpoint, target_viewpoint = (
        "auto" if place_m is None else place_m
        for place_m in (pair.source_viewpoint_m, pair.target_viewpoint_m)
    )
    result = register(
        pair.source_m,
        pair.target_m,
        source_viewpoint=source_viewpoint,
        target_viewpoint=target_viewpoint,
    )
    rotation_rad, _ = pose_error(result.T_target_source, pair.T_target_source)
    middle_m = np.median(pair.source_m, axis=0)[None]
    poses = result.T_target_source, pair.T_target_source
    found_m, truly_m = (transform_points(T, middle_m)[0] for T in poses)
    shift_m = float(np.linalg.norm(found_m - truly_m))
    is_right = rotation_rad < pair.success_rotation_rad and shift_m < pair.success_translation_m
    if result.status == "registered":
        outcome = "right" if is_right else "wrong"
    else:
        outcome = "refused, though right" if is_right else "refused"
    return {
        "outcome": outcome,
        "rotation_deg": float(np.rad2deg(rotation_rad)),
        "shift_m": shift_m,
        "confidence": result.confidence,
    }
