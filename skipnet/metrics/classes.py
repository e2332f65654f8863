"""Scores of a classifier, per class and over all."""

from __future__ import annotations

import numpy as np

from skipnet.types import FeatureClass, FloatArray, IntArray

CLASSES = len(FeatureClass)


def confusion_matrix(labels: IntArray, predicted: IntArray) -> IntArray:
    """(5, 5) counts[true, predicted] of (N,) classes."""
    counts = np.bincount(labels * CLASSES + predicted, minlength=CLASSES**2)
    return counts.reshape(CLASSES, CLASSES)


def f1_per_class(counts: IntArray) -> FloatArray:
    """(5,) F1 of a confusion matrix; NaN for a class that neither occurs nor is predicted."""
    right, either = np.diag(counts), counts.sum(axis=0) + counts.sum(axis=1)
    return np.where(either > 0, 2 * right / np.maximum(either, 1), np.nan)


def macro_f1(counts: IntArray) -> float:
    """Mean F1 over the classes that occur: every class counts the same, however rare."""
    return float(np.mean(np.nan_to_num(f1_per_class(counts))[counts.sum(axis=1) > 0]))
