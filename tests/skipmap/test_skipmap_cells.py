"""Cells and their keys: against NumPy's lexicographic order and a Python dict."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, random_rotation, transform_points
from skipnet.skipmap.cells import (
    cells_of,
    group_by_cell,
    halve,
    halve_steps,
    occupied_cells,
    pack,
    unpack,
)
from skipnet.skipmap.grouping import CELL_MAX, CELL_MIN, group_keys


def random_cells(count, low=CELL_MIN, high=CELL_MAX, seed=0):
    return np.random.default_rng(seed).integers(low, high, size=(count, 3), endpoint=True)


def test_a_point_lies_in_its_cell():
    points_m = np.random.default_rng(0).normal(scale=5, size=(2000, 3))
    origin_m = np.array([0.3, -2.0, 7.0])
    cells = cells_of(points_m, 0.25, origin_m)
    low_m = origin_m + 0.25 * cells
    assert ((low_m <= points_m + 1e-12) & (points_m < low_m + 0.25 + 1e-12)).all()


def test_packing_is_undone_at_the_ends_of_the_range_and_anywhere_between():
    corners = np.stack(np.meshgrid(*[[CELL_MIN, -1, 0, CELL_MAX]] * 3), axis=-1).reshape(-1, 3)
    for cells in (corners, random_cells(5000), random_cells(12).reshape(2, 2, 3, 3)):
        np.testing.assert_array_equal(unpack(pack(cells)), cells)
    assert pack(corners).min() >= 0


def test_keys_sort_as_cells_do_by_x_then_y_then_z():
    cells = random_cells(3000, -5, 5)
    order = np.lexsort((cells[:, 2], cells[:, 1], cells[:, 0]))
    np.testing.assert_array_equal(np.sort(pack(cells)), pack(cells[order]))


def test_halving_keys_is_halving_cells():
    ends = np.array([CELL_MIN, CELL_MIN + 1, -3, -1, 0, 1, 2, CELL_MAX - 1, CELL_MAX])
    cells = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(unpack(halve(pack(cells))), np.floor(cells / 2))


def test_adding_a_packed_difference_steps_to_the_neighbour():
    cells = random_cells(1000, -1000, 1000)
    step = pack(np.array([1, -1, 1])) - pack(np.zeros(3, dtype=np.int64))
    np.testing.assert_array_equal(unpack(pack(cells) + step), cells + [1, -1, 1])


def test_points_too_far_for_a_key_are_refused_with_advice():
    points_m = np.array([[0.0, 0, 0], [0, 0.001 * (CELL_MAX + 2), 0]])
    with pytest.raises(ValueError, match=r"more than 1048576 voxels of 0\.001 m.*larger voxel"):
        cells_of(points_m, 0.001, np.zeros(3))


@pytest.mark.parametrize("extent_m", [3.0, 900.0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("room", [2, 16])
def test_points_are_grouped_as_numpys_unique_groups_their_cells(extent_m, dtype, room, monkeypatch):
    monkeypatch.setattr("skipnet.skipmap.grouping._MOST_BITS_AT_FIRST", room)  # the rest grows
    rng = np.random.default_rng(6)
    points_m = rng.uniform(-extent_m, extent_m, size=(20_000, 3)).astype(dtype)
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    keys, row = group_by_cell(points_m, 0.5, T)
    own_m = transform_points(T, points_m)
    expected = np.unique(pack(cells_of(own_m, 0.5, np.zeros(3))), return_inverse=True)
    np.testing.assert_array_equal(keys, expected[0])
    np.testing.assert_array_equal(row, expected[1])
    np.testing.assert_array_equal(np.sort(occupied_cells(points_m, 0.5, T)), keys)


@pytest.mark.parametrize("extent", [1, 12, CELL_MAX])
@pytest.mark.parametrize("room", [2, 16])
def test_keys_are_grouped_as_numpys_unique_groups_them(extent, room, monkeypatch):
    monkeypatch.setattr("skipnet.skipmap.grouping._MOST_BITS_AT_FIRST", room)  # the rest grows
    keys = pack(random_cells(9000, -extent, extent))
    for given, expected in zip(group_keys(keys), np.unique(keys, return_inverse=True), strict=True):
        np.testing.assert_array_equal(given, expected)
    assert [len(part) for part in group_keys(keys[:0])] == [0, 0]


@pytest.mark.parametrize("far_m", [1e9, -1e9, np.nan])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_too_far_to_be_grouped_are_refused(far_m, axis):
    points_m = np.zeros((10, 3))
    points_m[4, axis] = far_m
    for group in (group_by_cell, occupied_cells):
        with pytest.raises(ValueError, match="choose a larger voxel_size_m"):
            group(points_m, 0.1, np.eye(4))


def test_steps_from_the_lowest_cell_halve_to_nothing_from_end_to_end():
    ends = np.array([CELL_MIN, CELL_MIN + 1, -1, 0, CELL_MAX])
    cells = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    steps = pack(cells) - pack(cells.min(axis=0))
    for doublings in range(22):
        expected = len(np.unique((cells - CELL_MIN) >> doublings, axis=0))
        assert len(np.unique(steps)) == expected
        steps = halve_steps(steps)
    assert expected == 1
