"""How right a classifier is: confusion matrix, F1 per class, by range and by family of scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skipnet.metrics.classes import confusion_matrix, f1_per_class, macro_f1
from skipnet.training.data.labelled import Samples
from skipnet.types import FeatureClass, IntArray

CLASS_NAMES = tuple(feature_class.name.lower() for feature_class in FeatureClass)
RANGE_LIMITS_M = (0.0, 2.0, 4.0, 6.0, 8.0, np.inf)


def score(
    samples: Samples, predicted: IntArray, families: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Scores in all, by range and by family.

    Args:
        samples: with the true classes.
        predicted: (N,) classes.
        families: names behind ``samples.families``.

    Returns:
        One entry per group: ``all``, ``range 0-2 m`` ..., ``family paper_room`` ...; each with
        ``voxels``, ``accuracy``, ``macro_f1``, and F1 and number of voxels of every class. Groups
        without a voxel are left out.
    """
    groups: dict[str, Any] = {"all": np.ones(len(samples), dtype=bool)}
    for low_m, high_m in zip(RANGE_LIMITS_M, RANGE_LIMITS_M[1:], strict=False):
        name = f"range {low_m:g}-{high_m:g} m" if np.isfinite(high_m) else f"range over {low_m:g} m"
        groups[name] = (samples.ranges_m >= low_m) & (samples.ranges_m < high_m)
    for index, family in enumerate(families):
        groups[f"family {family}"] = samples.families == index
    return {
        name: summarise(confusion_matrix(samples.labels[rows], predicted[rows]))
        for name, rows in groups.items()
        if rows.any()
    }


def summarise(counts: IntArray) -> dict[str, Any]:
    """The figures of one confusion matrix, under the names of ``score``."""
    f1 = f1_per_class(counts)
    return {
        "voxels": int(counts.sum()),
        "accuracy": float(np.trace(counts) / counts.sum()),
        "macro_f1": macro_f1(counts),
        **{f"f1_{name}": float(value) for name, value in zip(CLASS_NAMES, f1, strict=True)},
        **{f"voxels_{n}": int(k) for n, k in zip(CLASS_NAMES, counts.sum(axis=1), strict=True)},
    }


def table_rows(scores: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """One flat row per classifier and group, of ``{classifier: score(...)}``."""
    return [
        {"classifier": classifier, "group": group, **figures}
        for classifier, groups in scores.items()
        for group, figures in groups.items()
    ]
