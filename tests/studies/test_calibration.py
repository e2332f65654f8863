"""The confidence's fit, its calibration error."""

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from skipnet.metrics.calibration import expected_calibration_error
from skipnet.registration.findings import FEATURES
from skipnet.registration.verdict import MAX_VIOLATION
from skipnet.studies.calibration import REGULARISATION, fit
from skipnet.studies.trials import Trial


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
