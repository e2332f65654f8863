"""Fitting the verdict's confidence on simulated pairs: ``python -m skipnet.studies.calibration``.

Positives are pairs of every simulated family, undisturbed, with passers-by and without viewpoints,
and views of little overlap; negatives are scans of two different scenes of one kind, which for
paper rooms means the same shell with other furniture. No real cloud takes part. The seeds lie apart
from those of training and the benchmarks.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from skipnet.benchmark.datasets.overlapping import KINDS, Kind, goal_overlap, make_pair
from skipnet.geometry import pose_error
from skipnet.parallel.pools import worker_pool
from skipnet.registration.findings import FEATURES
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.pipeline import register
from skipnet.registration.verdict import CALIBRATION_FILE, MAX_VIOLATION
from skipnet.scans.scan import Viewpoint
from skipnet.simulation.scanning.degrading import add_passers_by
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import CALIBRATION
from skipnet.storage import write_text
from skipnet.types import FloatArray, Pair

FAMILIES = ("paper_room", "closed", "oblique", "curved", "doorway", "facade")
SCANNERS = ("terrestrial", "rings")
REGULARISATION = 10.0


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


def run_trials(
    scenes: int, config: RegistrationConfig | None = None, workers: int = 1
) -> Iterator[Trial]:
    """Register simulated positives and negatives of so many scenes of each kind."""
    numbers = range(0, 2 * scenes, 2)
    CALIBRATION.take(2 * scenes)  # all or none
    with worker_pool(workers) as pool:
        jobs = [
            pool.submit(trials_of_scene, family, scanner, number, config)
            for number in numbers
            for family in FAMILIES
            for scanner in SCANNERS
        ]
        jobs += [
            pool.submit(trials_of_views, kind, number, index / scenes, config)
            for index, number in enumerate(numbers)
            for kind in KINDS
        ]
        for job in jobs:
            yield from job.result()


def trials_of_scene(
    family: str, scanner: str, number: int, config: RegistrationConfig | None = None
) -> list[Trial]:
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
        *_same_and_different(pair, other, f"{name}/still", config),
        *_same_and_different(disturbed, disturbed_other, f"{name}/{busy} passers-by", config),
        *_same_and_different(pair, other, f"{name}/blind", config, viewpoint=None),
    ]


def trials_of_views(
    kind: Kind, number: int, share: float, config: RegistrationConfig | None = None
) -> list[Trial]:
    """A positive and a negative of views of little overlap, as ``benchmark=overlap`` has them."""
    name = f"{kind.name}/{CALIBRATION.scene(number)}"
    pair, other = (
        make_pair(kind, CALIBRATION.stand_ins(one), goal_overlap(share), name)
        for one in (number, number + 1)
    )
    return _same_and_different(pair, other, name, config)


def _same_and_different(
    pair: Pair,
    other: Pair,
    name: str,
    config: RegistrationConfig | None,
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
            config=config,
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


def fit(trials: list[Trial]) -> dict[str, object]:
    """Logistic regression of being right on the features (scikit-learn).

    Returns:
        What ``confidence.json`` holds: a weight per feature, the bias, and how it was fitted.
    """
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    refused = [trial.right for trial in trials if trial.violation > MAX_VIOLATION]
    features = np.array([trial.features for trial in trials])
    right = np.array([trial.right for trial in trials])
    model = make_pipeline(StandardScaler(), LogisticRegression(C=REGULARISATION, max_iter=1000))
    model.fit(features, right)
    scaler, logistic = model[0], model[1]
    weights = logistic.coef_[0] / scaler.scale_
    return {
        "weights": {name: round(float(w), 6) for name, w in zip(FEATURES, weights, strict=True)},
        "bias": round(float(logistic.intercept_[0] - weights @ scaler.mean_), 6),
        "refused": round(float(np.mean(refused)), 6) if refused else 0.0,
        "trials": len(trials),
        "right": int(right.sum()),
        "families": list(FAMILIES),
        "scanners": list(SCANNERS),
        "views": [kind.name for kind in KINDS],
        "first_seed": CALIBRATION.first,
        "regularisation": REGULARISATION,
    }


def main(scenes: int = 8) -> None:
    """Run the trials, fit the confidence and replace the shipped ``confidence.json``."""
    trials = []
    for trial in run_trials(scenes, workers=os.cpu_count() or 1):
        trials.append(trial)
        figures = " ".join(f"{value:.3f}" for value in trial.features)
        sys.stderr.write(f"{'right' if trial.right else 'wrong'} {trial.name} {figures}\n")
    write_text(CALIBRATION_FILE, json.dumps(fit(trials), indent=2) + "\n")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:2]))
