"""Lattices are found by their steps, wherever they lie, and nothing else is taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, random_rotation
from skipnet.scans.lattice import lattice_step_m
from skipnet.skipmap.tree import build_tree


def tree_of(points_m, T_given_own):
    turn = T_given_own[:3, :3].T
    return build_tree(points_m, 0.08, np.zeros(3), make_transform(turn, -turn @ T_given_own[:3, 3]))


@pytest.mark.parametrize("step_m", [0.01, 0.035, 0.05])
@pytest.mark.parametrize("offset_m", [0.0, 400_000.013])
def test_the_edge_of_a_lattice_is_found_in_any_place(step_m, offset_m):
    rng = np.random.default_rng(3)
    points_m = np.unique(np.round(rng.uniform(-3, 3, (20_000, 3)) / step_m), axis=0) * step_m
    T_given_own = make_transform(random_rotation(rng), np.full(3, offset_m) + [0, 1, 2])
    found_m = lattice_step_m(tree_of(points_m + offset_m, T_given_own), T_given_own)
    assert found_m == pytest.approx(step_m, rel=1e-3)


def test_arbitrary_points_points_on_two_grids_and_few_points_lie_on_none():
    rng = np.random.default_rng(4)
    points_m = rng.uniform(-3, 3, (20_000, 3))
    T = make_transform(random_rotation(rng), np.zeros(3))
    assert lattice_step_m(tree_of(points_m, T), T) == 0
    flat_m = points_m * [1, 1, 0]
    assert lattice_step_m(tree_of(flat_m, T), T) == 0
    assert lattice_step_m(tree_of(np.round(points_m[:40], 1), T), T) == 0
