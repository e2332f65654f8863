"""Which cells hang together, against SciPy's labels of a dense grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import label

from skipnet.skipmap.cell_table import CellTable
from skipnet.skipmap.connected import AROUND, HALF_AROUND, connected

SIDE = 14


def numbered(cells, rows):
    table = CellTable(cells, 1.0, np.zeros(3))
    whole, half = (
        connected(table.find_around(cells[rows], steps), rows, len(cells))
        for steps in (AROUND, HALF_AROUND)
    )
    assert whole.tolist() == half.tolist()
    return whole


@pytest.mark.parametrize("share", [0.02, 0.06, 0.2])
def test_groups_are_those_of_a_dense_grid(share):
    rng = np.random.default_rng(int(1000 * share))
    grid = rng.random((SIDE, SIDE, SIDE)) < share
    cells = np.argwhere(grid)
    labels, count = label(grid, np.ones((3, 3, 3)))
    number = numbered(cells, np.arange(len(cells)))
    assert number.max() + 1 == count > 1
    pairs = np.unique(np.column_stack([number, labels[tuple(cells.T)]]), axis=0)
    assert len(pairs) == count


def test_what_is_left_out_joins_nothing():
    cells = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2], [9, 9, 9]])
    assert numbered(cells, np.arange(4)).tolist() == [0, 0, 0, 1]
    assert numbered(cells, np.array([0, 2, 3])).tolist() == [0, 1, 2]
    assert numbered(cells, np.zeros(0, dtype=np.int64)).tolist() == []
