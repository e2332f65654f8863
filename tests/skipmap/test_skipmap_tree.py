"""The skip-tree's operations: each against brute force over the points themselves."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, random_rotation, transform_points
from skipnet.skipmap.tree import build_tree

SIZE_M = 0.4
ORIGIN_M = np.array([1.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def points_m():
    return np.random.default_rng(0).normal(scale=[2.0, 1.0, 0.5], size=(5000, 3))


@pytest.fixture(scope="module")
def tree(points_m):
    return build_tree(points_m, SIZE_M, ORIGIN_M)


def groups_of(points_m, size_m=SIZE_M, origin_m=ORIGIN_M):
    """Oracle: a dict from cell to the list of its points."""
    groups: dict[tuple[int, ...], list] = {}
    for point_m in points_m:
        groups.setdefault(tuple(np.floor((point_m - origin_m) / size_m).astype(int)), []).append(
            point_m
        )
    return groups


def assert_tree_of(tree, groups):
    assert [tuple(cell) for cell in tree.cells] == sorted(groups)
    for row, cell in enumerate(sorted(groups)):
        members_m = np.array(groups[cell])
        assert tree.moments.count[row] == len(members_m)
        np.testing.assert_allclose(tree.centroids_m[row], members_m.mean(axis=0), atol=1e-10)
        centred_m = members_m - members_m.mean(axis=0)
        covariance = centred_m.T @ centred_m / len(members_m)
        np.testing.assert_allclose(tree.moments.covariance[row], covariance, atol=1e-10)


def assert_same_trees(a, b):
    np.testing.assert_array_equal(a.keys, b.keys)
    np.testing.assert_array_equal(a.moments.count, b.moments.count)
    np.testing.assert_allclose(a.moments.first, b.moments.first, atol=1e-9)
    np.testing.assert_allclose(a.moments.second, b.moments.second, atol=1e-9)


def test_building_groups_the_points_by_cell(tree, points_m):
    assert_tree_of(tree, groups_of(points_m))


def test_the_order_of_points_does_not_matter(tree, points_m):
    shuffled_m = np.random.default_rng(1).permutation(points_m)
    assert_same_trees(build_tree(shuffled_m, SIZE_M, ORIGIN_M), tree)


def test_points_are_moved_on_the_way(points_m):
    T = make_transform(random_rotation(np.random.default_rng(5)), np.array([3.0, -1.0, 0.5]))
    moved = build_tree(transform_points(T, points_m), SIZE_M, ORIGIN_M)
    assert_same_trees(build_tree(points_m, SIZE_M, ORIGIN_M, T), moved)


def test_a_tree_of_single_points_stands_for_them(points_m):
    singles = build_tree(points_m, 1e-5)
    assert len(singles) == len(points_m)
    turn = make_transform(random_rotation(np.random.default_rng(4)), np.array([5.0, -3, 1]))
    for T in (None, turn):
        tree, expected = (build_tree(cloud, 0.5, T_tree_points=T) for cloud in (singles, points_m))
        np.testing.assert_array_equal(tree.origin_m, expected.origin_m)
        np.testing.assert_array_equal(tree.keys, expected.keys)
        np.testing.assert_allclose(tree.moments.mean, expected.moments.mean, atol=1e-9)
        np.testing.assert_allclose(tree.moments.covariance, expected.moments.covariance, atol=1e-9)


def test_integrating_and_adding_scans_equals_building_from_all_points(tree, points_m):
    first, second = points_m[:1700], points_m[1700:]
    assert_same_trees(build_tree(first, SIZE_M, ORIGIN_M).integrate(second), tree)
    added = build_tree(first, SIZE_M, ORIGIN_M).add(build_tree(second, SIZE_M, ORIGIN_M))
    assert_same_trees(added, tree)


def test_removing_a_scan_undoes_adding_it(tree, points_m):
    scan = build_tree(points_m[3000:], SIZE_M, ORIGIN_M)
    assert_same_trees(tree.remove(scan), build_tree(points_m[:3000], SIZE_M, ORIGIN_M))
    assert len(tree.remove(tree)) == 0


def test_removing_what_was_never_added_is_refused(tree, points_m):
    doubled = build_tree(np.repeat(points_m[:50], 400, axis=0), SIZE_M, ORIGIN_M)
    elsewhere = build_tree(points_m[:5] + 100.0, SIZE_M, ORIGIN_M)
    for other in (doubled, elsewhere):
        with pytest.raises(ValueError, match="never integrated"):
            tree.remove(other)


def test_exact_lookup_finds_every_cell_and_nothing_else(tree):
    present = {tuple(cell): row for row, cell in enumerate(tree.cells)}
    around = np.stack(np.meshgrid(*[np.arange(-16, 17)] * 3), axis=-1)
    expected = [present.get(tuple(cell), -1) for cell in around.reshape(-1, 3)]
    found = tree.find(around)
    assert found.shape == around.shape[:-1]
    np.testing.assert_array_equal(found.ravel(), expected)


@pytest.mark.parametrize("seed", range(8))
def test_box_query_returns_the_voxels_whose_cells_meet_the_box(tree, seed):
    rng = np.random.default_rng(seed)
    low_m = rng.normal(size=3)
    high_m = low_m + rng.uniform(0, 3, size=3)
    cell_low_m = ORIGIN_M + tree.cells * SIZE_M
    meets = ((cell_low_m <= high_m) & (cell_low_m + SIZE_M > low_m)).all(axis=1)
    np.testing.assert_array_equal(tree.box(low_m, high_m), np.flatnonzero(meets))


def test_box_query_of_empty_space_and_of_everything(tree, points_m):
    assert len(tree.box([50.0, 50, 50], [60.0, 60, 60])) == 0
    everything = tree.box(points_m.min(axis=0), points_m.max(axis=0))
    np.testing.assert_array_equal(everything, np.arange(len(tree)))


@pytest.mark.parametrize("radius_m", [0.0, 0.3, 1.5, 20.0])
def test_radius_query_agrees_with_scipys_ball_query(tree, radius_m):
    from scipy.spatial import cKDTree

    for centre_m in (np.zeros(3), np.array([1.7, -0.4, 0.2]), np.array([9.0, 9.0, 9.0])):
        expected = sorted(cKDTree(tree.centroids_m).query_ball_point(centre_m, radius_m))
        np.testing.assert_array_equal(tree.radius(centre_m, radius_m), expected)


def test_projections_seen_from_above(tree, points_m):
    groups = groups_of(points_m)
    points_in, top = {}, {}
    for (x, y, z), members_m in groups.items():
        points_in[x, y] = points_in.get((x, y), 0) + len(members_m)
        if (x, y) not in top or z > top[x, y][0]:
            top[x, y] = (z, np.mean(members_m, axis=0)[2])
    columns, counts = tree.project_2d()
    assert [tuple(column) for column in columns] == sorted(points_in)
    np.testing.assert_array_equal(counts, [points_in[column] for column in sorted(points_in)])
    columns, heights_m = tree.project_2_5d()
    assert [tuple(column) for column in columns] == sorted(top)
    np.testing.assert_allclose(heights_m, [top[column][1] for column in sorted(top)])


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_coarser_level_equals_building_it_from_the_points(tree, points_m, levels):
    coarse = tree.coarser(levels)
    assert coarse.voxel_size_m == SIZE_M * 2**levels
    assert_same_trees(coarse, build_tree(points_m, SIZE_M * 2**levels, ORIGIN_M))


def test_far_from_the_origin_covariances_keep_their_digits(points_m):
    far_m = points_m + [500_000.0, 5_000_000.0, 300.0]  # as in map coordinates
    near = build_tree(points_m, SIZE_M, np.zeros(3))
    far = build_tree(far_m, SIZE_M, np.array([500_000.0, 5_000_000.0, 300.0]))
    assert np.linalg.norm(build_tree(far_m, SIZE_M).origin_m - far_m.mean(axis=0)) < 10
    many = near.moments.count > 20
    rows = far.find(near.cells[many])
    np.testing.assert_allclose(
        far.moments.covariance[rows], near.moments.covariance[many], atol=1e-3 * SIZE_M**2
    )


@pytest.mark.parametrize("size_m", [0.0, -1.0, float("nan"), float("inf"), "1", None, [0.1]])
def test_a_voxel_size_that_is_no_length_is_refused(points_m, size_m):
    with pytest.raises(ValueError, match="voxel_size_m=.*: expected a positive length"):
        build_tree(points_m, size_m)


@pytest.mark.parametrize("kind", [">f4", "<f2", "i4", object])
def test_any_kind_of_numbers_is_divided(points_m, kind):
    given = np.round(points_m * 8).astype(kind)
    expected = build_tree(given.astype(np.float64), 2.0)
    for points in (given, given.tolist(), np.asfortranarray(given)):
        assert_same_trees(build_tree(points, 2.0), expected)


def test_no_points_and_different_grids_are_refused(tree, points_m):
    with pytest.raises(ValueError, match="at least one point"):
        build_tree(np.zeros((0, 3)), SIZE_M)
    for other in (build_tree(points_m, 0.5, ORIGIN_M), build_tree(points_m, SIZE_M, ORIGIN_M + 1)):
        with pytest.raises(ValueError, match="different grids.*same voxel_size_m"):
            tree.add(other)
        with pytest.raises(ValueError, match="different grids"):
            tree.remove(other)
