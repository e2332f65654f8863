"""Looking up voxels by cell: against a dict and a search through all of them, near and far."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, make_transform, random_rotation, transform_points
from skipnet.skipmap import cell_table
from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.cells import cells_of
from skipnet.skipmap.skipmap import build_skipmap

SIZE_M = 0.2
ORIGIN_M = np.array([0.3, -2.0, 7.0])


def wavy_cells():
    """(V, 3) cells of a wavy surface, as a scan has them."""
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-2, 2, size=(20_000, 3))
    points_m[:, 2] = 0.3 * np.sin(points_m[:, 0]) + rng.normal(scale=0.005, size=20_000)
    return build_skipmap(points_m, SIZE_M, np.array([0, 0, 5.0])).cells


@pytest.mark.parametrize("extent", [1, 9, 700, 60_000])
def test_cells_lead_to_what_a_dict_has(extent):
    rng = np.random.default_rng(1)
    cells = np.unique(rng.integers(-extent, extent, size=(3000, 3), endpoint=True), axis=0)
    stored = rng.permutation(cells)[: 1 + len(cells) // 2]
    row_of = {tuple(cell): row for row, cell in enumerate(stored)}
    asked = np.concatenate([cells, cells + [1, 0, -1], cells * 3 + 40_000])
    expected = [row_of.get(tuple(cell), -1) for cell in asked]
    table = CellTable(stored, SIZE_M, ORIGIN_M)
    np.testing.assert_array_equal(table.find(asked), expected)
    steps = rng.integers(-2, 3, size=(7, 3))
    np.testing.assert_array_equal(
        table.find_around(cells, steps), table.find(cells[:, None] + steps)
    )


def test_neighbours_lead_to_a_voxel_fewest_steps_away():
    cells = wavy_cells()
    table = CellTable(cells, SIZE_M, ORIGIN_M, with_neighbours=True)
    low, high = cells.min(axis=0) - 3, cells.max(axis=0) + 3
    asked = np.random.default_rng(1).integers(low, high, size=(3000, 3))
    row = table.find(asked)
    apart = np.abs(asked[:, None] - cells[None])
    near = (apart <= 1).all(axis=2)
    np.testing.assert_array_equal(row >= 0, near.any(axis=1))
    steps = np.where(near, apart.sum(axis=2), 99)
    found = row >= 0
    assert found.sum() > 100
    np.testing.assert_array_equal(steps[found, row[found]], steps[found].min(axis=1))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_are_moved_into_their_cells(dtype):
    rng = np.random.default_rng(2)
    table = CellTable(wavy_cells(), SIZE_M, ORIGIN_M)
    T = np.stack([make_transform(random_rotation(rng), rng.normal(size=3)) for _ in range(3)])
    target_m = ORIGIN_M + rng.uniform(-3, 3, size=(2000, 3)) * [1, 1, 0.3]
    points_m = transform_points(invert(T[1]), target_m).astype(dtype)
    found = table.find_moved(T, points_m, 1500)
    assert found.shape == (3, 1500)
    for T_table_points, rows in zip(T, found, strict=True):
        moved_m = transform_points(T_table_points, points_m.astype(np.float64))[:1500]
        expected = table.find(cells_of(moved_m, SIZE_M, ORIGIN_M))
        # In float32 a point next to a border may fall on either side.
        assert (rows == expected).mean() > (0.998 if dtype == np.float32 else 0.9999)
    assert (found[1] >= 0).sum() > 50
    np.testing.assert_array_equal(table.find_moved(T, points_m)[:, :1500], found)


def test_lines_meet_the_voxels_on_their_way():
    rng = np.random.default_rng(3)
    table = CellTable(wavy_cells(), SIZE_M, ORIGIN_M)
    starts_m = ORIGIN_M + rng.uniform(-2, 2, size=(60, 3))
    ways = rng.normal(size=(60, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ends_m = rng.uniform(-1, 4, size=60)
    lines, rows = table.find_along(starts_m, ways, 0.2, ends_m, 0.1)
    expected = []
    for line in range(60):
        before = -1
        for walked_m in 0.2 + 0.1 * np.arange(max(np.ceil((ends_m[line] - 0.2) / 0.1), 0)):
            place_m = starts_m[line] + walked_m * ways[line]
            row = int(table.find(cells_of(place_m, SIZE_M, ORIGIN_M)))
            if row >= 0 and row != before:
                expected.append((line, row))
            before = row
    assert len(expected) > 30
    assert list(zip(lines.tolist(), rows.tolist(), strict=True)) == expected


@pytest.mark.parametrize("places", [1, 64, 1 << 20])
@pytest.mark.parametrize("with_neighbours", [False, True])
def test_no_voxel_is_lost_however_far_they_spread(places, with_neighbours, monkeypatch):
    monkeypatch.setattr(cell_table, "_MOST_PLACES", places)  # the fewer, the more share them
    rng = np.random.default_rng(4)
    middles = [(0, 0, 0), (20_000, -15_000, 9000), (-(1 << 20) + 9, (1 << 20) - 9, 8)]
    cells = [middle + rng.integers(-8, 8, size=(400, 3)) for middle in middles]
    cells.append(rng.integers(-(1 << 20), 1 << 20, size=(3000, 3)))
    cells = np.unique(np.concatenate(cells), axis=0)
    table = CellTable(cells, SIZE_M, ORIGIN_M, with_neighbours)
    np.testing.assert_array_equal(table.find(cells), np.arange(len(cells)))
    far = np.array([[1, 1, 1], [-1, 0, 0], [0, 1 << 40, 0], [0, 0, -(1 << 60)]]) * ((1 << 20) + 1)
    assert (table.find(far) == -1).all()


def test_far_points_nan_and_empty_tables_find_nothing():
    far_m = np.array(
        [[1e6, 0, 0], [0, -1e6, 0], [1e30, 1e30, -1e30], [0, 0, np.inf], [0, np.nan, 0]]
    )
    empty = CellTable(np.zeros((0, 3), dtype=np.int64), SIZE_M, ORIGIN_M)
    for table in (CellTable(wavy_cells(), SIZE_M, ORIGIN_M, with_neighbours=True), empty):
        assert (table.find_moved(np.eye(4)[None], far_m) == -1).all()
    assert (empty.find(wavy_cells()) == -1).all()
    assert len(empty.find_along(far_m[:2], np.eye(3)[:2], 0.0, np.ones(2), 0.1)[0]) == 0
