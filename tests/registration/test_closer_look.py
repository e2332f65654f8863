"""A closer look: exact agreement beats rough agreement, as far as the scans' noise lets it."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform
from skipnet.registration import aligners
from skipnet.registration.judging.judge import Judge
from skipnet.registration.pipeline import register
from skipnet.scans.evidence import build_evidence, centroid_errors_voxels
from skipnet.scans.range_image import build_range_image
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.1
SAMPLES = 4000


def rolling_ground(seed, noise_m):
    """A scan from 3 m above gentle waves, 10 m wide."""
    rng = np.random.default_rng(seed)
    xy_m = rng.uniform(-5, 5, (60_000, 2))
    x_m, y_m = xy_m.T
    z_m = 0.08 * np.cos(0.9 * x_m) + 0.08 * np.sin(0.7 * y_m + 0.5 * x_m)
    points_m = np.column_stack([xy_m, z_m + rng.normal(0, noise_m, len(xy_m))])
    sensor_m = np.array([0.0, 0.0, 3.0])
    skipmap = build_skipmap(points_m, VOXEL_M, sensor_m)
    return build_evidence(skipmap, build_range_image(points_m, sensor_m), np.random.default_rng(0))


def both_scores(noise_m):
    """Scores of the true pose and of one half a metre aside, loosely and after the closer look."""
    judge = Judge(rolling_ground(1, noise_m), rolling_ground(2, noise_m), SAMPLES, 10.0)
    aside = make_transform(np.eye(3), np.array([0.5, 0.0, 0.0]))
    T = np.stack([np.eye(4), aside])
    loose = judge.score(T)
    return loose, judge.closer(T, loose)


def test_what_fits_roughly_falls_behind_what_fits_exactly():
    loose, closer = both_scores(noise_m=0.001)
    assert loose.total[1] > 0.5 * loose.total[0], "loosely, the wrong pose is a close rival"
    assert closer.total[1] < 0.3 * closer.total[0]
    assert closer.total[0] == pytest.approx(loose.total[0])
    np.testing.assert_array_equal(closer.overlap, loose.overlap)
    np.testing.assert_array_equal(closer.violation, loose.violation)


def test_noisy_scans_are_not_held_to_what_they_cannot_keep():
    loose, closer = both_scores(noise_m=0.05)
    np.testing.assert_array_equal(closer.total, loose.total)


def test_what_fits_exactly_agrees_closely_and_what_fits_roughly_does_not():
    exact, noisy = (
        Judge(rolling_ground(1, noise_m), rolling_ground(2, noise_m), SAMPLES, 10.0)
        for noise_m in (0.001, 0.05)
    )
    aside = make_transform(np.eye(3), np.array([0.5, 0.0, 0.0]))
    assert exact.closeness(np.eye(4)) > 0.95
    assert exact.closeness(aside) < 0.8
    assert noisy.closeness(aside) == 1.0, "nobody can tell"


def test_a_centroid_is_as_sure_as_its_points_are_many():
    rng = np.random.default_rng(0)
    sigma_m, per_voxel = 0.004, 50
    xy_m = rng.uniform(0, 2, (int(per_voxel * (2 / VOXEL_M) ** 2), 2))
    points_m = np.column_stack([xy_m, 0.05 + rng.normal(0, sigma_m, len(xy_m))])
    errors = centroid_errors_voxels(build_skipmap(points_m, VOXEL_M, np.array([1.0, 1.0, 3.0])))
    expected = sigma_m / np.sqrt(per_voxel) / VOXEL_M
    assert np.median(errors) == pytest.approx(expected, rel=0.1)


def test_a_fine_alignment_that_the_judge_likes_less_is_undone(monkeypatch):
    pair = simulate_pair("oblique", 3, points=40_000).pair
    polish = aligners.polish
    drift = make_transform(np.eye(3), np.array([0.3, 0.3, 0.0]))

    def drifting(T_target_source, source, target):
        """The fine alignment, and then away."""
        fine = polish(T_target_source, source, target)
        fine.T_target_source[0] = drift @ fine.T_target_source[0]
        return fine

    monkeypatch.setattr(aligners, "polish", drifting)
    result = register(pair.source_m, pair.target_m)
    error_m = result.T_target_source[:3, 3] - pair.T_target_source[:3, 3]
    assert np.linalg.norm(error_m) < 0.05
