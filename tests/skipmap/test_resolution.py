"""The voxel size: what it promises about the voxels it makes, and what must not change it."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.clouds.statistics import principal_frame
from skipnet.geometry import make_transform, random_rotation, transform_points
from skipnet.skipmap.resolution import (
    MAX_ROUGHER,
    MAX_VOXELS,
    MIN_POINTS_PER_VOXEL,
    TARGET_VOXELS,
    choose_voxel_size,
)
from skipnet.skipmap.tree import build_tree


def box_surface(count, edges_m, seed=0):
    """Points spread evenly over the six faces of a box."""
    rng = np.random.default_rng(seed)
    edges_m = np.asarray(edges_m, dtype=np.float64)
    area = np.repeat([edges_m[1] * edges_m[2], edges_m[2] * edges_m[0], edges_m[0] * edges_m[1]], 2)
    face = rng.choice(6, size=count, p=area / area.sum())
    points = rng.uniform(size=(count, 3))
    points[np.arange(count), face // 2] = face % 2
    return points * edges_m


@pytest.mark.parametrize("edges_m", [(10, 10, 3), (30, 3, 3), (0.3, 0.2, 0.2), (400, 300, 50)])
def test_a_dense_scan_gets_about_the_target_number_of_voxels(edges_m):
    points_m = box_surface(300_000, edges_m)
    occupied = len(build_tree(points_m, choose_voxel_size(points_m, points_m)))
    assert 0.6 * TARGET_VOXELS < occupied < 1.6 * TARGET_VOXELS


@pytest.mark.parametrize("count", [300, 3000])
def test_a_sparse_scan_gets_voxels_with_points_in_them(count):
    points_m = box_surface(count, (10, 10, 3))
    occupied = len(build_tree(points_m, choose_voxel_size(points_m, points_m)))
    assert 0.6 * MIN_POINTS_PER_VOXEL < count / occupied < 2 * MIN_POINTS_PER_VOXEL


def test_the_sparser_scan_decides_for_all():
    dense_m, sparse_m = box_surface(200_000, (10, 10, 3)), box_surface(4000, (10, 10, 3))
    own = choose_voxel_size(sparse_m)
    assert own > choose_voxel_size(dense_m)
    for clouds_m in ((dense_m, sparse_m), (sparse_m, dense_m), (dense_m, sparse_m, dense_m)):
        assert choose_voxel_size(*clouds_m) == own


def test_a_map_leaves_a_scan_of_a_part_of_it_its_own_resolution_as_far_as_it_can():
    rng = np.random.default_rng(6)
    points_m = rng.uniform(size=(2_000_000, 3)) * [100.0, 100.0, 0.0]
    part_m = points_m[(np.abs(points_m[:, :2] - 50) < 20).all(axis=1)]
    wish_m, of_part_m = choose_voxel_size(points_m), choose_voxel_size(part_m)
    assert wish_m > MAX_ROUGHER * of_part_m
    size_m = choose_voxel_size(points_m, part_m)
    assert choose_voxel_size(part_m, points_m) == size_m
    assert size_m == pytest.approx(max(MAX_ROUGHER * of_part_m, wish_m / 2), rel=0.06)
    # A smaller part yet would need more voxels of the map than there may be.
    corner_m = points_m[(points_m[:, :2] < 5).all(axis=1)]
    size_m = choose_voxel_size(points_m, corner_m)
    assert len(build_tree(points_m, size_m)) == pytest.approx(MAX_VOXELS, rel=0.2)
    # A sparse map stays as rough as its points are apart.
    sparse_m = points_m[:20_000]
    assert choose_voxel_size(sparse_m, part_m) == choose_voxel_size(sparse_m)
    # One map among many scans: the scans decide.
    assert choose_voxel_size(points_m, part_m, part_m) == choose_voxel_size(points_m, part_m)


def test_motion_and_order_do_not_matter_and_the_unit_scales_along():
    rng = np.random.default_rng(3)
    points_m = box_surface(20_000, (8, 5, 3))
    size_m = choose_voxel_size(points_m)
    T = make_transform(random_rotation(rng), rng.normal(scale=1000, size=3))
    assert choose_voxel_size(transform_points(T, points_m)) == size_m
    assert choose_voxel_size(rng.permutation(points_m)) == size_m
    assert choose_voxel_size(points_m, T_given_own=[principal_frame(points_m)]) == size_m
    assert choose_voxel_size(points_m * 1000) == pytest.approx(1000 * size_m)


def test_a_few_far_outliers_hardly_matter():
    points_m = box_surface(50_000, (10, 10, 3))
    outliers_m = np.random.default_rng(4).normal(scale=300, size=(20, 3))
    with_outliers_m = np.concatenate([points_m, outliers_m])
    assert choose_voxel_size(with_outliers_m) == pytest.approx(choose_voxel_size(points_m), rel=0.2)


@pytest.mark.parametrize("count", [3, 4, 10])
def test_the_smallest_clouds_get_a_positive_size(count):
    assert choose_voxel_size(np.random.default_rng(5).normal(size=(count, 3))) > 0


@pytest.mark.parametrize("count", [7, 500])
def test_strays_on_both_sides_far_out_leave_a_size(count):
    points_m = np.random.default_rng(0).normal(size=(count, 3))
    strays_m = np.array([[1e5, 0, 0], [-1e5, 0, 0], [0, 0, 4e5], [0, -7e5, 0]])
    size_m = choose_voxel_size(np.concatenate([points_m, strays_m]))
    assert 0.05 < size_m < 2e6
