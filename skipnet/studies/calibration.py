"""Fitting the verdict's confidence on simulated pairs: ``skipnet study calibration``.

Positives are pairs of every simulated family, undisturbed, with passers-by and without viewpoints,
views of little overlap, and situations in which a wrong pose fits well; negatives are scans of two
different scenes of one kind, which for paper rooms means the same shell with other furniture. No
real cloud takes part. The scenes are those of no training and no benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.overlapping import KINDS, Kind, goal_overlap, make_pair
from skipnet.geometry import pose_error
from skipnet.metrics.calibration import expected_calibration_error
from skipnet.registration.findings import FEATURES
from skipnet.registration.pipeline import register
from skipnet.registration.verdict import CALIBRATION_FILE, MAX_VIOLATION
from skipnet.scans.scan import Viewpoint
from skipnet.simulation.scanning.degrading import add_passers_by
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import CALIBRATION
from skipnet.simulation.situations.catalog import SITUATIONS, is_right
from skipnet.storage import write_text
from skipnet.studies.options import CalibrationConfig
from skipnet.studies.study import do_all, report
from skipnet.types import FloatArray, Pair
from skipnet.viz.tables import Table

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


def run(config: CalibrationConfig) -> dict[str, Any]:
    """Try every scene, fit the confidence, write it and report; the summary comes back."""
    folder = Path(config.output_dir)
    of_jobs = do_all(jobs(config.scenes, config.seed), _do, folder, config.workers)
    trials = [Trial.from_json(one) for of_job in of_jobs for one in of_job["trials"]]
    fitted = fit(trials, CALIBRATION.scene(config.seed))
    text = json.dumps(fitted, indent=2) + "\n"
    write_text(folder / CALIBRATION_FILE.name, text)
    if config.ship:
        write_text(CALIBRATION_FILE, text)
    return report(
        config,
        "Calibration: what the verdict's confidence rests on",
        {
            "scenes": f"{config.scenes} of each kind, from number {config.seed} of "
            f"{CALIBRATION.first}, each with another that it has nothing to do with",
            "kinds": ", ".join((*FAMILIES, *(kind.name for kind in KINDS))),
        },
        [weights_table(fitted), trials_table(trials)],
        sentences=[
            f"{fitted['right']} of {fitted['trials']} answers are right.",
            f"Expected calibration error on these very trials: {error_of(fitted, trials):.3f}.",
        ],
        fit=fitted,
    )


def jobs(scenes: int, skip: int = 0) -> dict[str, Job]:
    """Of so many scenes of each kind, each with the next one as the other."""
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


def _do(job: Job) -> dict[str, Any]:
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


def fit(trials: Sequence[Trial], first_seed: int = CALIBRATION.first) -> dict[str, Any]:
    """Logistic regression of being right on the features (scikit-learn).

    Args:
        trials: what came of the registrations.
        first_seed: of their scenes, to be kept with the fit.

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
        "situations": list(SITUATIONS),
        "first_seed": first_seed,
        "regularisation": REGULARISATION,
    }


def error_of(fitted: dict[str, Any], trials: Sequence[Trial]) -> float:
    """Expected calibration error of a fit on trials."""
    weights = np.array([fitted["weights"][name] for name in FEATURES])
    logits = np.array([trial.features @ weights for trial in trials]) + fitted["bias"]
    right = np.array([float(trial.right) for trial in trials])
    return expected_calibration_error(1 / (1 + np.exp(-logits)), right)


def weights_table(fitted: dict[str, Any]) -> Table:
    """What the confidence is made of."""
    rows = tuple((name, f"{weight:.3f}") for name, weight in fitted["weights"].items())
    note = f"Logistic regression; of what is refused a share of {fitted['refused']:.3f} is right."
    bias = ("bias", f"{fitted['bias']:.3f}")
    return Table("The fit", ("figure", "weight"), (*rows, bias), note)


def trials_table(trials: Sequence[Trial]) -> Table:
    """Every trial with what the verdict saw."""
    rows = tuple(
        (
            trial.name,
            "right" if trial.right else "wrong",
            f"{trial.violation:.4f}",
            *(f"{value:.3f}" for value in trial.features),
        )
        for trial in trials
    )
    return Table("Every trial", ("scans", "pose", "violation", *FEATURES), rows, folded=True)
