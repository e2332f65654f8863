"""scikit-learn's classifiers on the same patches and the same split, as a yardstick."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from skipnet.progress import tell
from skipnet.training.data.labelled import Samples
from skipnet.types import FloatArray, IntArray

SVC_SAMPLES = 20_000
"""An SVC's training time grows with the square of the samples; it sees at most so many."""
COMPARED_VOXELS = 40_000
"""Voxels drawn from the test for the comparison: kNN and SVC are slow to answer."""


def make_peers(seed: int) -> dict[str, Any]:
    """The four classifiers, untrained, by name; inputs are standardised where scale matters."""
    from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
    from sklearn.neighbors import KNeighborsClassifier
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler
    from sklearn.svm import SVC

    return {
        "RandomForest": RandomForestClassifier(
            n_estimators=200, min_samples_leaf=2, n_jobs=2, random_state=seed
        ),
        "SVC": make_pipeline(StandardScaler(), SVC(C=10.0, cache_size=1000)),
        "kNN": make_pipeline(StandardScaler(), KNeighborsClassifier(10, weights="distance")),
        "HistGradientBoosting": HistGradientBoostingClassifier(max_iter=200, random_state=seed),
    }


def predict_with_peers(
    training: Samples, sample_weights: FloatArray, patches: FloatArray, seed: int
) -> tuple[dict[str, IntArray], dict[str, float]]:
    """Train each peer as the network was trained and let it classify.

    Args:
        training: the network's training set.
        sample_weights: (N,) the weights its loss used; every peer that takes weights gets them.
        patches: (K, 125) to classify.
        seed: of the peers' own randomness, and of the SVC's share of the samples.

    Returns:
        (K,) classes and the seconds of training, per peer.
    """
    predicted: dict[str, IntArray] = {}
    seconds: dict[str, float] = {}
    for name, peer in make_peers(seed).items():
        tell(f"comparing with {name}")
        rows = np.arange(len(training))
        if name == "SVC" and len(rows) > SVC_SAMPLES:
            rows = np.random.default_rng(seed).choice(len(rows), SVC_SAMPLES, replace=False)
        start_s = time.perf_counter()
        options = _weight_option(name, sample_weights[rows])
        peer.fit(training.patches[rows], training.labels[rows], **options)
        seconds[name] = time.perf_counter() - start_s
        predicted[name] = np.asarray(peer.predict(patches), dtype=np.int64)
    return predicted, seconds


def _weight_option(name: str, weights: FloatArray) -> dict[str, FloatArray]:
    if name == "kNN":  # it takes no weights
        return {}
    return {"svc__sample_weight" if name == "SVC" else "sample_weight": weights}
