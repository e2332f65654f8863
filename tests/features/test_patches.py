"""Patches against brute force and against what must not change them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.features.patches import CELLS, build_patches, feature_voxels
from skipnet.geometry import random_rotation
from skipnet.skipmap.skipmap import SkipMap, build_skipmap

VOXEL_M = 0.1


def corner_points(sign: float, seed: int = 0) -> np.ndarray:
    """Three quarter planes that meet at the origin, seen from sign * (1, 1, 1)."""
    rng = np.random.default_rng(seed)
    parts = []
    for axis in range(3):
        points = rng.uniform(0, 1.5, (12_000, 3))
        points[:, axis] = 0.0
        parts.append(points)
    return np.concatenate(parts) - 3.0 * sign  # the sensor stands at the origin


@pytest.fixture(scope="module")
def corner() -> SkipMap:
    return build_skipmap(corner_points(-1.0), VOXEL_M, np.zeros(3))


def test_axis_aligned_is_the_occupancy_of_the_voxels_around(corner: SkipMap) -> None:
    rows = np.arange(0, len(corner), 7)
    patches = build_patches(corner, rows, "axis_aligned").reshape(-1, CELLS, CELLS, CELLS)
    occupied = {tuple(cell) for cell in corner.cells}
    for row, patch in zip(rows[:20], patches, strict=False):
        for place in np.ndindex(CELLS, CELLS, CELLS):
            cell = tuple(corner.cells[row] + np.array(place) - CELLS // 2)
            assert patch[place] == (cell in occupied)


def test_features_are_the_voxels_with_something_curved_in_reach(corner: SkipMap) -> None:
    curved = {tuple(c) for c in corner.cells[corner.curvatures > 0.01]}
    expected = [
        row
        for row, cell in enumerate(corner.cells)
        if any(tuple(cell + np.array(step) - 1) in curved for step in np.ndindex(3, 3, 3))
    ]
    np.testing.assert_array_equal(feature_voxels(corner, 0.01), expected)
    assert 0 < len(expected) < len(corner)


def test_a_flat_wall_has_no_feature() -> None:
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-2, 2, (40_000, 3))
    points_m[:, 2] = 1.0
    skipmap = build_skipmap(points_m, VOXEL_M, np.zeros(3))
    assert len(feature_voxels(skipmap)) == 0


def patches_by_position(points_m: np.ndarray, R: np.ndarray, places_m: np.ndarray) -> np.ndarray:
    """Patches at the voxels nearest to given places, of the cloud turned by R."""
    skipmap = build_skipmap(points_m @ R.T, VOXEL_M, np.zeros(3))
    gap_m = np.linalg.norm((places_m @ R.T)[:, None] - skipmap.centroids_m, axis=2)
    return build_patches(skipmap, gap_m.argmin(axis=1))


def test_turning_the_scan_changes_surface_frame_patches_little() -> None:
    # The grid turns too, so voxels differ; what remains must be small beside what turning does to
    # a patch in the scan's own axes, and beside the difference between places.
    points_m = corner_points(-1.0)
    places_m = 3.0 + np.array([[0.0, 0, 0], [0.5, 0, 0], [0.7, 0.7, 0]])
    rng = np.random.default_rng(5)
    turned = [patches_by_position(points_m, random_rotation(rng), places_m) for _ in range(6)]
    mean = np.mean(turned, axis=0)
    within = np.mean([np.linalg.norm(one - mean, axis=1) for one in turned])
    between = np.linalg.norm(mean[[0, 0, 1]] - mean[[1, 2, 2]], axis=1).min()
    assert within < 0.75 * between


def test_concave_and_convex_corners_differ_when_the_viewpoint_is_known() -> None:
    def patch(sign: float, viewpoint_known: bool) -> np.ndarray:
        points_m = corner_points(sign)
        skipmap = build_skipmap(points_m, VOXEL_M, np.zeros(3) if viewpoint_known else None)
        row = np.linalg.norm(skipmap.centroids_m + 3.0 * sign, axis=1).argmin()
        return build_patches(skipmap, np.array([row]))[0]

    known = np.linalg.norm(patch(-1.0, True) - patch(1.0, True))
    unknown = np.linalg.norm(patch(-1.0, False) - patch(1.0, False))
    assert known > 5 * unknown


def test_without_a_viewpoint_the_sign_of_the_normals_does_not_matter(corner: SkipMap) -> None:
    rows = feature_voxels(corner)
    flipped = replace(corner, normals=-corner.normals, viewpoint_m=None)
    expected = build_patches(replace(corner, viewpoint_m=None), rows)
    np.testing.assert_allclose(build_patches(flipped, rows), expected, atol=1e-5)


def test_nothing_to_describe(corner: SkipMap) -> None:
    for kind in ("surface_frame", "axis_aligned"):
        assert build_patches(corner, np.zeros(0, dtype=int), kind).shape == (0, 125)


@pytest.mark.parametrize(
    ("rows", "kind", "message"),
    [([0], "round", "surface_frame, axis_aligned"), ([-1], "axis_aligned", "rows of the skip-map")],
)
def test_bad_input_says_what_is_wrong(corner: SkipMap, rows, kind, message) -> None:
    with pytest.raises(ValueError, match=message):
        build_patches(corner, np.array(rows), kind)
