"""Points that are there more than once."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.clouds.repeats import first_of_each
from skipnet.scans.describing import common_voxel_size_m


@pytest.fixture(scope="module")
def cloud_m():
    rng = np.random.default_rng(0)
    return rng.uniform(-1, 1, (30_000, 3)) * [4.0, 3.0, 0.001]


@pytest.mark.parametrize("copies", [2, 3, 20])
@pytest.mark.parametrize("in_turn", [True, False])
def test_each_point_is_kept_once_in_its_order(cloud_m, copies, in_turn):
    rows = np.repeat(np.arange(len(cloud_m)), copies)
    if not in_turn:
        rows = np.random.default_rng(1).permutation(rows)
    kept = first_of_each(cloud_m[rows])
    _, first = np.unique(cloud_m[rows], axis=0, return_index=True)
    np.testing.assert_array_equal(kept, np.sort(first))


@pytest.mark.parametrize("step_m", [0.0, 0.001, 0.01])
def test_a_scan_that_hardly_repeats_is_kept_whole(cloud_m, step_m):
    rounded_m = np.round(cloud_m / step_m) * step_m if step_m else cloud_m
    assert len(np.unique(rounded_m, axis=0)) > 0.9 * len(cloud_m)
    assert first_of_each(rounded_m) is None


@pytest.mark.parametrize("count", [0, 1, 5])
def test_few_points_are_kept_whole(count):
    assert first_of_each(np.zeros((count, 3))) is None


def test_a_cloud_merged_with_itself_asks_for_the_same_voxels(cloud_m):
    merged_m = np.concatenate([cloud_m, cloud_m, cloud_m[::-1]])
    assert common_voxel_size_m([merged_m]) == common_voxel_size_m([cloud_m])
