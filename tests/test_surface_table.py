"""Looking up surfaces: against a search through all voxels, small scans and wide ones."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.registration import surface_table
from skipnet.registration.surface_table import build_surface_table
from skipnet.skipmap.cells import cells_of
from skipnet.skipmap.skipmap import build_skipmap


@pytest.fixture(scope="module")
def skipmap():
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-2, 2, size=(20_000, 3))
    points_m[:, 2] = 0.3 * np.sin(points_m[:, 0]) + rng.normal(scale=0.005, size=20_000)
    return build_skipmap(points_m, 0.2, np.array([0, 0, 5.0]))


@pytest.mark.parametrize("neighbours", [True, False])
@pytest.mark.parametrize("largest_box", [1 << 23, 0])
def test_every_point_finds_the_voxel_fewest_steps_away(
    skipmap, neighbours, largest_box, monkeypatch
):
    monkeypatch.setattr(surface_table, "_LARGEST_BOX", largest_box)
    table = build_surface_table(skipmap, neighbours)
    points_m = np.random.default_rng(1).uniform(-3, 3, size=(3000, 3))
    points_m[:, 2] *= 0.3
    row = table.find(*points_m.T)
    cells = cells_of(points_m, 0.2, skipmap.origin_m)
    apart = np.abs(cells[:, None].astype(int) - skipmap.cells[None])
    near = (apart <= int(neighbours)).all(axis=2)
    np.testing.assert_array_equal(row >= 0, near.any(axis=1))
    steps = np.where(near, apart.sum(axis=2), 99)
    found = row >= 0
    assert found.sum() > 100
    np.testing.assert_array_equal(
        steps[found, row[found]], steps[found].min(axis=1), "a nearer voxel was passed over"
    )


def test_far_points_and_empty_maps_find_nothing(skipmap):
    table = build_surface_table(skipmap)
    assert table.find(*np.full((3, 1), 1e6))[0] == -1
    assert table.find(*np.full((3, 1), -1e6))[0] == -1
    line_m = np.zeros((50, 3))
    line_m[:, 0] = np.linspace(0, 3, 50)
    nothing = build_surface_table(build_skipmap(line_m, 0.2))
    assert nothing.find(*np.zeros((3, 1)))[0] == -1
