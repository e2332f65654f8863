"""Cells and their keys: against NumPy's lexicographic order and a Python dict."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.skipmap.cells import (
    CELL_MAX,
    CELL_MIN,
    CellIndex,
    cells_of,
    group_by_cell,
    halve,
    neighbour_rows,
    pack,
    unpack,
)


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


@pytest.mark.parametrize("extent", [3, 40, CELL_MAX])
def test_the_index_finds_what_a_dict_finds(extent):
    keys = np.unique(pack(random_cells(4000, -extent, extent)))
    rng = np.random.default_rng(1)
    stored = rng.permutation(keys)[: max(1, 2 * len(keys) // 3)]
    oracle = {int(key): row for row, key in enumerate(stored)}
    queries = rng.choice(keys, size=(50, 40))
    expected = [[oracle.get(int(key), -1) for key in line] for line in queries]
    np.testing.assert_array_equal(CellIndex(stored).find(queries), expected)


def test_the_index_grows_batch_by_batch_and_keeps_first_values():
    keys = np.unique(pack(random_cells(3000, -30, 30)))
    index, oracle = CellIndex(keys[:5]), {int(key): row for row, key in enumerate(keys[:5])}
    rng = np.random.default_rng(2)
    for batch in range(30):
        some = rng.choice(keys, size=200, replace=False)
        values = 1000 * batch + np.arange(200)
        index.insert(some, values)
        for key, value in zip(some.tolist(), values.tolist(), strict=True):
            oracle.setdefault(key, value)
    expected = [oracle.get(int(key), -1) for key in keys]
    np.testing.assert_array_equal(index.find(keys), expected)


def test_an_empty_index_finds_nothing():
    index = CellIndex(np.zeros(0, dtype=np.int64))
    np.testing.assert_array_equal(index.find(pack(random_cells(7))), np.full(7, -1))


def test_points_too_far_for_a_key_are_refused_with_advice():
    points_m = np.array([[0.0, 0, 0], [0, 0.001 * (CELL_MAX + 2), 0]])
    with pytest.raises(ValueError, match=r"more than 1048576 voxels of 0\.001 m.*larger voxel"):
        cells_of(points_m, 0.001, np.zeros(3))


# A narrow cloud goes through a table over its box, a wide one through a sort or a hash table.
@pytest.mark.parametrize("extent_m", [3.0, 900.0])
def test_points_are_grouped_as_numpys_unique_groups_their_cells(extent_m):
    points_m = np.random.default_rng(6).uniform(-extent_m, extent_m, size=(4000, 3))
    keys, row = group_by_cell(np.ascontiguousarray(points_m.T), 0.5)
    expected = np.unique(pack(cells_of(points_m, 0.5, np.zeros(3))), return_inverse=True)
    np.testing.assert_array_equal(keys, expected[0])
    np.testing.assert_array_equal(row, expected[1])


@pytest.mark.parametrize("extent", [4, 2000])
def test_neighbours_are_those_that_a_dict_finds(extent):
    cells = np.unique(np.random.default_rng(7).integers(-extent, extent, size=(300, 3)), axis=0)
    cells = np.concatenate([cells, cells[:50] + [0, 0, 3 * extent]])
    offsets = np.array([[0, 0, 0], [1, 0, 0], [0, -1, 2], [-3, 0, 0]])
    row_of = {tuple(cell): row for row, cell in enumerate(cells)}
    around = [[row_of.get(tuple(cell + offset), -1) for offset in offsets] for cell in cells]
    expected = [[row for row in rows if row >= 0] for rows in around]
    rows, ends = neighbour_rows(pack(cells), offsets)
    np.testing.assert_array_equal(rows, np.concatenate(expected))
    np.testing.assert_array_equal(np.diff(ends), [len(rows) for rows in expected])
    assert ends[0] == 0
    rows, ends = neighbour_rows(np.zeros(0, dtype=np.int64), offsets)
    assert len(rows) == 0 and ends.tolist() == [0]


def test_neighbours_of_many_cells_are_found_piece_by_piece(monkeypatch):
    monkeypatch.setattr("skipnet.skipmap.cells._CELLS_AT_ONCE", 700)
    cells = np.stack(np.meshgrid(*3 * [np.arange(20)], indexing="ij"), axis=-1).reshape(-1, 3)
    rows, ends = neighbour_rows(pack(cells), np.array([[0, 0, 1], [-1, 0, 0]]))
    above, behind = cells[:, 2] < 19, cells[:, 0] > 0
    np.testing.assert_array_equal(np.diff(ends), above.astype(int) + behind)
    owner = np.repeat(np.arange(len(cells)), np.diff(ends))
    steps = cells[rows] - cells[owner]
    assert set(map(tuple, steps)) == {(0, 0, 1), (-1, 0, 0)}


@pytest.mark.parametrize("far_m", [1e9, -1e9, np.nan])
def test_points_too_far_to_be_grouped_are_refused(far_m):
    xyz_m = np.zeros((3, 10))
    xyz_m[1, 4] = far_m
    with pytest.raises(ValueError, match="choose a larger voxel_size_m"):
        group_by_cell(xyz_m, 0.1)
