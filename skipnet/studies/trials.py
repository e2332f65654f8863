"""Trials of the calibration: pairs of scans that belong together, and pairs that do not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.overlapping import KINDS, Kind, goal_overlap, make_pair
from skipnet.geometry import pose_error
from skipnet.registration.pipeline import register
from skipnet.scans.scan import Viewpoint
from skipnet.simulation.scanning.degrading import add_passers_by
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import CALIBRATION
from skipnet.simulation.situations.catalog import SITUATIONS, is_right
from skipnet.types import FloatArray, Pair

FAMILIES = ("paper_room", "closed", "oblique", "curved", "doorway", "facade")
SCANNERS = ("terrestrial", "rings")


@dataclass(frozen=True)
class Trial:
    """One registration whose outcome is known."""

    name: str
    features: FloatArray
    """(F,) what the verdict saw, in the order of ``FEATURES``."""
    violation: float
    """Share of voxels that lie in free space that the other scan saw."""
    right: bool
    """The pose is within the pair's thresholds; never so for scans of different scenes."""

    @property
    def as_json(self) -> dict[str, Any]:
        """Plain numbers, without loss."""
        return {**vars(self), "features": self.features.tolist()}

    @staticmethod
    def from_json(fields: dict[str, Any]) -> Trial:
        """The trial that ``as_json`` told of."""
        return Trial(**{**fields, "features": np.array(fields["features"])})


Job = partial[list[Trial]]
"""Registers all that belongs to one scene."""


def jobs(scenes: int, skip: int = 0) -> dict[str, Job]:
    """Of so many scenes of each kind, each with the next one as the other; of situations all."""
    CALIBRATION.take(2 * scenes, skip)  # all or none
    numbers = range(skip, skip + 2 * scenes, 2)
    chosen: dict[str, Job] = {
        f"{family}/{scanner}/{number}": partial(trials_of_scene, family, scanner, number)
        for number in numbers
        for family in FAMILIES
        for scanner in SCANNERS
    }
    for situation in SITUATIONS:
        for number in range(skip, skip + 2 * scenes):
            chosen[f"{situation}/{number}"] = partial(trials_of_situation, situation, number)
    for index, number in enumerate(numbers):
        share = index / scenes
        for kind in KINDS:
            views = partial(trials_of_views, kind, number, share)
            chosen[f"{kind.name}/{number}/{share:.3f}"] = views
    return chosen


def do(job: Job) -> dict[str, Any]:
    """One job's trials, as JSON keeps them."""
    return {"trials": [trial.as_json for trial in job()]}


def trials_of_scene(family: str, scanner: str, number: int) -> list[Trial]:
    """Of two scenes, undisturbed, with passers-by, and without viewpoints."""
    seed, seed_of_other = CALIBRATION.take(2, skip=number)
    pair = simulate_pair(family, seed, scanner=scanner, rotation="any").pair
    other = simulate_pair(family, seed_of_other, scanner=scanner, rotation="any").pair
    rng = np.random.default_rng(seed)
    name, busy = f"{family}/{scanner}/{seed}", int(rng.integers(2, 12))
    disturbed, disturbed_other = (
        replace(
            one,
            source_m=add_passers_by(one.source_m, busy, rng),
            target_m=add_passers_by(one.target_m, busy, rng),
        )
        for one in (pair, other)
    )
    return [
        *_same_and_different(pair, other, f"{name}/still"),
        *_same_and_different(disturbed, disturbed_other, f"{name}/{busy} passers-by"),
        *_same_and_different(pair, other, f"{name}/blind", viewpoint=None),
    ]


def trials_of_views(kind: Kind, number: int, share: float) -> list[Trial]:
    """A positive and a negative of views of little overlap, as ``benchmark=overlap`` has them."""
    name = f"{kind.name}/{CALIBRATION.scene(number)}"
    pair, other = (
        make_pair(kind, CALIBRATION.stand_ins(one), goal_overlap(share), name)
        for one in (number, number + 1)
    )
    return _same_and_different(pair, other, name)


def trials_of_situation(name: str, number: int) -> list[Trial]:
    """One that is hard to be honest about; some have no right answer."""
    situation = SITUATIONS[name](CALIBRATION.scene(number))
    result = register(situation.source_m, situation.target_m)
    found = result.findings
    if found is None:
        return []
    right = is_right(result.T_target_source, situation)
    return [Trial(f"{name}/{number}/{situation.name}", found.features, found.violation, right)]


def _same_and_different(
    pair: Pair,
    other: Pair,
    name: str,
    viewpoint: Viewpoint = "auto",
) -> list[Trial]:
    """The pair, and its source with the target of another; without those that found no pose."""
    trials = []
    for target_m, kind in ((pair.target_m, "same"), (other.target_m, "different")):
        result = register(
            pair.source_m,
            target_m,
            source_viewpoint=viewpoint,
            target_viewpoint=viewpoint,
        )
        rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
        right = (
            kind == "same"
            and rotation_rad < pair.success_rotation_rad
            and translation_m < pair.success_translation_m
        )
        found = result.findings
        if found is not None:
            trials.append(Trial(f"{name}/{kind}", found.features, found.violation, right))
    return trials
