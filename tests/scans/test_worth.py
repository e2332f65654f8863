"""What voxels are worth as evidence: large planes count once, what stands on them in full."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.features.primitives import find_planes
from skipnet.scans.evidence import build_evidence
from skipnet.scans.worth import PLANE_WORTH, voxel_worth
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.1


def sampled(count, low_m, high_m, seed=0):
    return np.random.default_rng(seed).uniform(low_m, high_m, size=(count, 3))


def worth_of(points_m):
    skipmap = build_skipmap(points_m, VOXEL_M)
    return skipmap, voxel_worth(skipmap, find_planes(skipmap))


def test_a_plane_counts_as_so_many_voxels_however_large():
    for half_m in (2.0, 4.0):
        count = int(15_000 * half_m**2)
        _, worth = worth_of(sampled(count, [-half_m, -half_m, 0.04], [half_m, half_m, 0.06]))
        assert len(worth) > 4 * PLANE_WORTH
        assert worth.sum() == pytest.approx(PLANE_WORTH, rel=0.1)


def test_a_knob_on_a_plane_weighs_more_than_its_area():
    plane_m = sampled(60_000, [-2, -2, 0.04], [2, 2, 0.06])
    ways = np.random.default_rng(1).normal(size=(4000, 3))
    knob_m = 0.25 * ways / np.linalg.norm(ways, axis=1, keepdims=True) + [0, 0, 0.4]
    skipmap, worth = worth_of(np.concatenate([plane_m, knob_m]))
    on_knob = skipmap.centroids_m[:, 2] > 0.15
    assert on_knob.mean() < 0.08
    assert worth[on_knob].sum() > 0.5 * worth.sum()


def test_gentle_waves_are_no_plane():
    xy_m = sampled(80_000, [-4, -4, 0], [4, 4, 1])[:, :2]
    z_m = 0.6 * np.sin(0.9 * xy_m[:, 0]) * np.cos(0.8 * xy_m[:, 1])
    _, worth = worth_of(np.column_stack([xy_m, z_m]))
    assert worth.sum() > 20 * PLANE_WORTH


def test_the_first_voxels_of_a_weighted_sample_stand_for_all():
    rng = np.random.default_rng(3)
    points_m = sampled(80_000, [-3, -3, 0.0], [3, 3, 0.1])
    skipmap = build_skipmap(points_m, VOXEL_M)
    worth = rng.uniform(0.02, 1.0, len(skipmap))
    values = (skipmap.centroids_m[:, 0] > 1).astype(float) + worth
    plain, weighted = values.mean(), (values * worth).sum() / worth.sum()
    estimates = []
    for seed in range(300):
        evidence = build_evidence(skipmap, None, np.random.default_rng(seed)).valued(worth)
        np.testing.assert_allclose(evidence.weights, worth[evidence.order], rtol=1e-6)
        assert (np.diff(evidence.arrivals) >= 0).all()
        shares = evidence.shares(200)
        np.testing.assert_allclose(shares.sum(axis=1), 1, rtol=1e-5)
        estimates.append(shares @ values[evidence.order[:200]])
    error = np.std(estimates, axis=0) / np.sqrt(len(estimates))
    np.testing.assert_array_less(np.abs(np.mean(estimates, axis=0) - [plain, weighted]), 5 * error)


def test_all_voxels_stand_for_themselves():
    points_m = sampled(20_000, [-2, -2, 0.0], [2, 2, 0.1])
    skipmap = build_skipmap(points_m, VOXEL_M)
    worth = np.linspace(0.1, 1.0, len(skipmap))
    evidence = build_evidence(skipmap, None, np.random.default_rng(0)).valued(worth)
    by_number, by_worth = evidence.shares(len(skipmap))
    np.testing.assert_allclose(by_number, 1 / len(skipmap), rtol=1e-5)
    np.testing.assert_allclose(by_worth, worth[evidence.order] / worth.sum(), rtol=1e-5)


def test_gathered_voxels_are_the_same_ones_for_each_number_and_stand_for_as_much():
    points_m = sampled(20_000, [-2, -2, 0.0], [2, 2, 0.1])
    skipmap = build_skipmap(points_m, VOXEL_M)
    worth = np.random.default_rng(4).uniform(0.02, 1.0, len(skipmap))
    evidence = build_evidence(skipmap, None, np.random.default_rng(5)).valued(worth)
    gathered = evidence.gathered({300, 24, 10**6})
    for count, first in ((24, 0), (300, 24), (len(skipmap), 300)):
        assert (np.diff(gathered.order[first:count]) > 0).all()
        rows, others = np.argsort(gathered.order[:count]), np.argsort(evidence.order[:count])
        for name in ("order", "points_m", "normals", "weights", "sides", "clear"):
            np.testing.assert_array_equal(
                getattr(gathered, name)[:count][rows], getattr(evidence, name)[:count][others]
            )
        np.testing.assert_allclose(
            gathered.shares(count)[:, rows], evidence.shares(count)[:, others], rtol=1e-5
        )
    with pytest.raises(ValueError, match=r"samples=25: expected one of \(24, 300, 1000000\)"):
        gathered.shares(25)
