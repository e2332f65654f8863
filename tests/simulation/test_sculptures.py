"""Sculptures: tubes that close, and what a scanner with a light sees of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from skipnet.geometry import transform_points
from skipnet.simulation.scanning.figures import HEIGHT_M, turn_sculpture
from skipnet.simulation.scenes.sculptures import RINGS, SEGMENTS, tube

STRAIGHT = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 2.0], RINGS)


def volume_m3(surface):
    """Of what a closed surface holds, by the divergence theorem."""
    a, b, c = np.moveaxis(surface.vertices_m[surface.triangles], 1, 0)
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


@pytest.mark.parametrize("flat", [1.0, 3.0])
def test_a_straight_tube_is_a_cylinder_seen_from_outside(flat):
    radii_m = np.full(RINGS, 0.5)
    radii_m[[0, -1]] = 1e-9
    surface = tube(STRAIGHT, radii_m, flat=flat)
    whole_m3 = np.pi * 0.5**2 * 2.0 / flat
    assert volume_m3(surface) == pytest.approx(whole_m3, rel=0.03)  # positive: normals look out
    inner = surface.vertices_m[SEGMENTS:-SEGMENTS]
    assert np.linalg.norm(inner[:, :2], axis=1).max() == pytest.approx(0.5)


def test_a_bent_tube_keeps_its_radius_about_its_curve():
    angle = np.linspace(0, 1.5 * np.pi, RINGS)
    spine_m = np.stack([np.cos(angle), np.sin(angle), 0.1 * angle], axis=1)
    vertices_m = tube(spine_m, np.full(RINGS, 0.2)).vertices_m.reshape(RINGS, SEGMENTS, 3)
    off_m = np.linalg.norm(vertices_m - spine_m[:, None], axis=2)
    np.testing.assert_allclose(off_m, 0.2, atol=1e-9)
    turned = np.einsum(
        "rsc,rsc->rs", vertices_m[1:] - spine_m[1:, None], vertices_m[:-1] - spine_m[:-1, None]
    )
    assert turned.min() > 0.99 * 0.2**2  # outlines do not twist from one to the next


def test_what_the_light_falls_on_is_seen_and_two_scans_meet():
    table = turn_sculpture(24_003)
    source_m, target_m = table.clouds_m(0.4)
    again_m, _ = turn_sculpture(24_003).clouds_m(0.4)
    np.testing.assert_array_equal(source_m, again_m)
    all_m, _ = replace(table, light_aside_m=None).clouds_m(0.4)
    assert 0.5 * len(all_m) < len(source_m) < len(all_m)
    moved_m = transform_points(table.T_target_source(0.4), source_m)
    near_m = cKDTree(target_m).query(moved_m)[0]
    assert np.mean(near_m < 0.01 * HEIGHT_M) > 0.5
    wrong_m = cKDTree(target_m).query(transform_points(table.T_target_source(0.6), source_m))[0]
    assert np.mean(wrong_m < 0.01 * HEIGHT_M) < np.mean(near_m < 0.01 * HEIGHT_M) - 0.2


def test_sculptures_are_of_many_kinds_and_as_high_as_figures():
    sizes_m = []
    for seed in range(24_100, 24_108):
        table = turn_sculpture(seed)
        points_m = table.clouds_m(0.0)[1]
        sizes_m.append(np.linalg.norm(np.ptp(points_m, axis=0)))
        assert len(points_m) > 5000 and np.isfinite(points_m).all()
    assert max(sizes_m) < 2 * HEIGHT_M and min(sizes_m) > 0.5 * HEIGHT_M
    assert np.std(sizes_m) > 0.01 * HEIGHT_M
