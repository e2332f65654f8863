"""The confidence's fit, its calibration error, and the disturbances it learns from."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from skipnet.metrics.calibration import expected_calibration_error
from skipnet.registration.findings import FEATURES
from skipnet.registration.verdict import MAX_VIOLATION
from skipnet.simulation.scanning.degrading import add_passers_by
from skipnet.studies.calibration import REGULARISATION, Trial, fit


def trials(count=400):
    rng = np.random.default_rng(0)
    features = rng.uniform(0, 1, (count, len(FEATURES)))
    right = features[:, :4] @ [2.0, -1.0, 3.0, 1.0] + rng.normal(0, 0.3, count) > 2.5
    return [
        Trial(str(i), f, MAX_VIOLATION / 2, bool(r))
        for i, (f, r) in enumerate(zip(features, right, strict=True))
    ]


def test_the_fit_is_scikit_learn_s_in_the_features_own_units():
    sample = trials()
    features = np.array([trial.features for trial in sample])
    mean, spread = features.mean(axis=0), features.std(axis=0)
    oracle = LogisticRegression(C=REGULARISATION).fit(
        (features - mean) / spread, [t.right for t in sample]
    )
    fitted = fit(sample)
    logits = features @ [fitted["weights"][name] for name in FEATURES] + fitted["bias"]
    expected = oracle.decision_function((features - mean) / spread)
    np.testing.assert_allclose(logits, expected, atol=1e-3)


def test_how_often_a_refused_pose_is_right_all_the_same_is_kept():
    sample = trials()
    refused = [Trial("refused", np.ones(len(FEATURES)), 0.05, right) for right in (True, False)]
    assert fit(sample)["refused"] == 0
    assert fit([*sample, *refused * 2, refused[1]])["refused"] == 0.4


def test_the_calibration_error_of_a_hand_worked_case():
    confidence = np.array([0.15, 0.15, 0.95, 0.95])
    right = np.array([0.0, 0.0, 1.0, 0.0])
    # Half the cases are 0.15 too sure, half 0.95 - 0.5.
    assert expected_calibration_error(confidence, right) == pytest.approx(0.5 * 0.15 + 0.5 * 0.45)


def test_passers_by_stop_beams_on_their_way():
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points_m = 5 * directions
    moved_m = add_passers_by(points_m, 3, np.random.default_rng(2))
    ranges_m = np.linalg.norm(moved_m, axis=1)
    np.testing.assert_allclose(moved_m / ranges_m[:, None], directions, atol=1e-9)
    stopped = ranges_m < 4.9
    assert 0 < stopped.sum() < 1000
    assert ranges_m[stopped].min() > 1.4 and ranges_m[stopped].max() < 4.1
    np.testing.assert_array_equal(moved_m[~stopped], points_m[~stopped])
    np.testing.assert_array_equal(add_passers_by(points_m, 0, rng), points_m)
