"""Fitting the verdict's confidence on simulated pairs: ``skipnet study calibration``.

Positives are pairs of every simulated family, undisturbed, with passers-by and without viewpoints,
views of little overlap, and situations in which a wrong pose fits well; negatives are scans of two
different scenes of one kind, which for paper rooms means the same shell with other furniture. No
real cloud takes part. The scenes are those of no training and no benchmark.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.overlapping import KINDS
from skipnet.metrics.calibration import expected_calibration_error
from skipnet.registration.findings import FEATURES
from skipnet.registration.verdict import CALIBRATION_FILE, MAX_VIOLATION
from skipnet.simulation.seeds import CALIBRATION
from skipnet.simulation.situations.catalog import SITUATIONS
from skipnet.storage import write_text
from skipnet.studies.options import CalibrationConfig
from skipnet.studies.study import do_all, report
from skipnet.studies.trials import FAMILIES, SCANNERS, Trial, do, jobs
from skipnet.viz.tables import Table

REGULARISATION = 10.0


def run(config: CalibrationConfig) -> dict[str, Any]:
    """Try every scene, fit the confidence, write it and report; the summary comes back."""
    folder = Path(config.output_dir)
    of_jobs = do_all(jobs(config.scenes, config.seed), do, folder, config.workers)
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
