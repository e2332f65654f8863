"""Cylindrical grids against counting by hand, and what turns and opposite axes make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.features.cylinders import choose_keypoints
from skipnet.features.frames import tangent_frames
from skipnet.features.grids import GRID_SHAPE, REACH_VOXELS, cylinder_grids, turned_over
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.skipmap.skipmap import SkipMap, build_skipmap
from skipnet.types import FloatArray


@pytest.fixture(scope="module")
def skipmap() -> SkipMap:
    scans, _ = simulate_scans("clutter", 3, 1, points=30_000)
    return build_skipmap(scans[0].points_m.astype(np.float64), 0.15, np.zeros(3))


def by_hand(skipmap: SkipMap, row: int) -> FloatArray:
    """(8, 6, 16, 7) of the finer scale, one voxel around after the other."""
    _, heights, radii, sectors, _ = GRID_SHAPE
    axis, first, second = tangent_frames(skipmap, np.array([row]))[0].T
    reach = REACH_VOXELS[0]
    cells: dict[tuple[int, int, int], list[FloatArray]] = {}
    for centroid_m, normal in zip(skipmap.centroids_m, skipmap.normals, strict=True):
        way = (centroid_m - skipmap.centroids_m[row]) / skipmap.voxel_size_m
        height, flat = way @ axis, np.array([way @ first, way @ second])
        radius = np.hypot(*flat)
        if abs(height) >= reach or radius >= reach or radius < 1e-3:
            continue
        outwards = (flat[0] * first + flat[1] * second) / radius
        around = np.cross(axis, outwards)
        turn = np.arctan2(flat[1], flat[0]) / (2 * np.pi) % 1
        cell = (
            int((height + reach) / (2 * reach) * heights),
            int(radius / reach * radii),
            int(turn * sectors),
        )
        a, o, t = normal @ axis, normal @ outwards, normal @ around
        cells.setdefault(cell, []).append(np.array([a * a, o * o, t * t, a * o, a * t, o * t]))
    grid = np.zeros(GRID_SHAPE[1:])
    for cell, products in cells.items():
        grid[cell] = [np.log(1 + len(products)), *np.mean(products, axis=0)]
    return grid


def test_the_finer_scale_is_what_is_counted_by_hand(skipmap: SkipMap) -> None:
    rows = choose_keypoints(skipmap, 6)
    found = cylinder_grids(skipmap, rows)[:, 0]
    for row, grid in zip(rows, found, strict=True):
        expected = by_hand(skipmap, int(row))
        # A centroid within float32 of a cell's border may count on either side of it.
        off = np.abs(grid - expected).max(axis=-1) > 1e-4
        assert off.mean() < 0.01
        assert expected[..., 0].sum() == pytest.approx(grid[..., 0].sum(), rel=0.02)


def test_opposite_axes_give_the_grids_turned_over(skipmap: SkipMap) -> None:
    rows = choose_keypoints(skipmap, 40)
    blind = skipmap.seen_from(None)
    opposite = replace(blind, normals=-blind.normals)
    one, other = cylinder_grids(blind, rows), cylinder_grids(opposite, rows)
    np.testing.assert_array_equal(turned_over(turned_over(one)), one)
    off = np.abs(turned_over(one) - other).max(axis=-1) > 1e-3
    assert off.mean() < 0.01


def test_no_voxels_give_no_grids(skipmap: SkipMap) -> None:
    assert cylinder_grids(skipmap, np.zeros(0, dtype=np.int64)).shape == (0, *GRID_SHAPE)
