"""The Skip-map: neighbourhoods, curvature and normals against NumPy on the actual points."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.skipmap import MIN_WIDTH, build_skipmap, skipmap_of_tree
from skipnet.skipmap.tree import build_tree

SIZE_M = 0.3


@pytest.fixture(scope="module")
def scan_m():
    return simulate_pair("paper_room", 2, points=20_000).pair.target_m.astype(np.float64)


@pytest.fixture(scope="module")
def skipmap(scan_m):
    return build_skipmap(scan_m, SIZE_M, np.zeros(3))


def neighbourhood_of(points_m, skipmap, row):
    """Oracle: the points in the 27 cells around a voxel, found by comparing all points."""
    low_m = skipmap.origin_m + (skipmap.cells[row] - 1) * SIZE_M
    return points_m[((points_m >= low_m) & (points_m < low_m + 3 * SIZE_M)).all(axis=1)]


def test_every_voxel_is_described_by_the_points_of_its_27_cells(scan_m, skipmap):
    for row in np.random.default_rng(0).choice(len(skipmap), 150, replace=False):
        around_m = neighbourhood_of(scan_m, skipmap, row)
        assert len(around_m) >= 6
        values, vectors = np.linalg.eigh(np.cov(around_m.T, bias=True))
        np.testing.assert_allclose(skipmap.eigenvalues_m2[row], values, atol=1e-9)
        assert skipmap.curvatures[row] == pytest.approx(values[0] / values.sum(), abs=1e-7)
        if values[1] > 2 * values[0] + 1e-6:  # else the normal is not determined
            assert abs(skipmap.normals[row] @ vectors[:, 0]) == pytest.approx(1, abs=1e-6)


def test_counts_and_centroids_are_of_the_voxels_own_points(scan_m, skipmap):
    cells = np.floor((scan_m - skipmap.origin_m) / SIZE_M).astype(int)
    rows = skipmap.table.find(cells)
    for row in np.random.default_rng(1).choice(len(skipmap), 100, replace=False):
        own_m = scan_m[rows == row]
        assert skipmap.counts[row] == len(own_m)
        np.testing.assert_allclose(skipmap.centroids_m[row], own_m.mean(axis=0), atol=1e-9)


@pytest.mark.parametrize("least", [3, 6, 40])
def test_effective_voxels_are_those_with_enough_points_around_that_span_a_surface(scan_m, least):
    tree = build_tree(scan_m[::3], SIZE_M)
    cells = np.floor((scan_m[::3] - tree.origin_m) / SIZE_M).astype(int)
    effective = []
    for cell in tree.cells:
        around_m = scan_m[::3][(np.abs(cells - cell) <= 1).all(axis=1)]
        if len(around_m) >= least:
            lengths = np.linalg.svd(around_m - around_m.mean(axis=0), compute_uv=False)
            if lengths[1] > MIN_WIDTH * lengths[0]:
                effective.append(cell)
    np.testing.assert_array_equal(skipmap_of_tree(tree, min_points=least).cells, effective)


def test_a_lone_scan_line_has_no_effective_voxel():
    line_m = np.linspace([-3.0, 0.2, 0.1], [3.0, 1.5, 0.4], 3000)
    noisy_m = line_m + np.random.default_rng(0).normal(scale=0.004, size=line_m.shape)
    assert len(build_skipmap(noisy_m, SIZE_M)) == 0
    assert len(build_skipmap(np.concatenate([noisy_m, noisy_m + [0, 0, 0.2]]), SIZE_M)) > 0


def test_normals_point_to_the_sensor_and_forget_it_when_told(skipmap):
    towards = np.einsum("vi,vi->v", skipmap.normals, -skipmap.centroids_m)
    assert (towards >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(skipmap.normals, axis=1), 1.0)
    elsewhere_m = np.array([100.0, 0.0, 0.0])
    turned = skipmap.seen_from(elsewhere_m)
    assert (np.einsum("vi,vi->v", turned.normals, elsewhere_m - turned.centroids_m) >= 0).all()
    assert skipmap.seen_from(None).viewpoint_m is None
    np.testing.assert_array_equal(turned.curvatures, skipmap.curvatures)


def test_lookup_knows_every_effective_voxel_and_nothing_else(skipmap):
    rows = np.arange(len(skipmap))
    np.testing.assert_array_equal(skipmap.table.find(skipmap.cells), rows)
    np.testing.assert_array_equal(skipmap.find_around(rows, np.zeros((1, 3), int))[:, 0], rows)
    assert (skipmap.table.find(skipmap.cells + 500) == -1).all()


def test_the_next_level_from_the_tree_equals_the_one_from_the_points(scan_m):
    tree = build_tree(scan_m, SIZE_M)
    coarse = skipmap_of_tree(tree.coarser(), np.zeros(3))
    direct = skipmap_of_tree(build_tree(scan_m, 2 * SIZE_M, tree.origin_m), np.zeros(3))
    np.testing.assert_array_equal(coarse.keys, direct.keys)
    np.testing.assert_allclose(coarse.eigenvalues_m2, direct.eigenvalues_m2, atol=1e-9)
    np.testing.assert_allclose(coarse.curvatures, direct.curvatures, atol=1e-7)
    np.testing.assert_allclose(coarse.centroids_m, direct.centroids_m, atol=1e-9)


def test_planes_are_flat_and_edges_of_a_room_are_not():
    # A floor and a wall that meet along x = z = 0; the sensor sees both from inside.
    rng = np.random.default_rng(0)
    floor = rng.uniform([0, -2, 0], [4, 2, 0], size=(40_000, 3))
    wall = rng.uniform([0, -2, 0], [0, 2, 3], size=(30_000, 3))
    skipmap = build_skipmap(np.concatenate([floor, wall]), 0.2, np.array([2.0, 0, 1.5]))
    x, y, z = skipmap.centroids_m.T
    inside = np.abs(y) < 1.5
    on_floor, on_wall = (x > 0.6) & (x < 3.5) & inside, (z > 0.6) & (z < 2.5) & inside
    at_edge = (x < 0.2) & (z < 0.2) & inside
    np.testing.assert_allclose(skipmap.curvatures[on_floor | on_wall], 0, atol=1e-12)
    np.testing.assert_allclose(skipmap.normals[on_floor], [[0, 0, 1]] * on_floor.sum(), atol=1e-9)
    np.testing.assert_allclose(skipmap.normals[on_wall], [[1, 0, 0]] * on_wall.sum(), atol=1e-9)
    assert skipmap.curvatures[at_edge].min() > 0.05


def test_bad_input_is_refused_as_by_the_tree():
    with pytest.raises(ValueError, match="positive length"):
        build_skipmap(np.zeros((10, 3)), 0.0)
