"""Stated covariances: the squares are those of the errors, the table counts what is registered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet import register
from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.studies.coverage import LIMIT, coverage_table, squared_deviations


def test_the_limit_is_the_chi_square_of_six_degrees_of_freedom():
    from scipy.stats import chi2

    assert pytest.approx(chi2.ppf(0.9, 6), rel=1e-4) == LIMIT


def test_squared_deviations_are_those_about_the_centre():
    pair = simulate_pair("oblique", 62_400, rotation="any").pair
    found = register(pair.source_m, pair.target_m)
    centre_m = found.findings.covariance_centre_m
    assert np.abs(centre_m).max() < 10
    deviations = np.array([0.001, 0.002, 0.004, 0.01, 0.02, 0.04])
    findings = replace(found.findings, covariance=np.diag(deviations**2))
    found = replace(found, findings=findings)
    # Off by one deviation of the turn about x, and two of the shift along z, of the centre.
    turn = rotation_from_vector(np.array([deviations[0], 0.0, 0.0]))
    off = make_transform(turn, centre_m - turn @ centre_m + [0, 0, 2 * deviations[5]])
    truth = np.linalg.inv(off) @ found.T_target_source
    assert squared_deviations(found, truth) == pytest.approx(5.0, rel=1e-4)


def test_swapped_scans_state_the_same_about_the_same_centre():
    pair = simulate_pair("oblique", 62_401, rotation="any").pair
    there, back = register(pair.source_m, pair.target_m), register(pair.target_m, pair.source_m)
    T = there.T_target_source
    centre_m = T[:3, :3] @ back.findings.covariance_centre_m + T[:3, 3]
    np.testing.assert_allclose(centre_m, there.findings.covariance_centre_m, atol=1e-6)
    both = np.kron(np.eye(2), T[:3, :3])
    np.testing.assert_allclose(
        both @ back.findings.covariance @ both.T, there.findings.covariance, rtol=1e-4, atol=1e-13
    )


def test_the_table_counts_registered_pairs_alone():
    outcomes = [
        {"status": "registered", "squares": 3.0},
        {"status": "registered", "squares": 30.0},
        {"status": "ambiguous", "squares": 3.0},
    ]
    table = coverage_table({"rooms": outcomes, "none": outcomes[2:]})
    assert table.rows == (("rooms", "3", "2", "1", "50%"), ("none", "1", "0", "0", "–"))
