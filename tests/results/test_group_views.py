"""Many scans in 3-D: residuals to the others, scans in doubt at each of their places."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud
from skipnet.projects.assembly import Place
from skipnet.results.group_views import group_viewer
from skipnet.results.inputs import given_cloud
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.viz.lengths import Lengths
from skipnet.viz.residuals import residuals_m


def test_residuals_are_to_the_nearest_point_of_another_scan_within_reach():
    plane_m = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), -1).reshape(-1, 3)
    scans_m = [plane_m, plane_m + [0, 0, 0.2], plane_m + [0, 0, 0.5], plane_m + [0, 0, 50]]
    rows = [np.arange(5), np.arange(5, 9), np.arange(3), np.arange(2)]
    found_m = residuals_m(scans_m, rows, 1.0)
    assert [len(one_m) for one_m in found_m] == [5, 4, 3, 2]
    for one_m, expected_m in zip(found_m, (0.2, 0.2, 0.3, 1.0), strict=True):
        np.testing.assert_allclose(one_m, expected_m)


@pytest.fixture(scope="module")
def room():
    scans, _ = simulate_scans("paper_room", 3, 3, points=15_000)
    result = skipnet.register_many([scan.points_m for scan in scans])
    given = [
        given_cloud(Cloud(scan.points_m, colour=np.full((len(scan.points_m), 3), 9)), f"{k}.ply")
        for k, scan in enumerate(scans)
    ]
    return given, result


def test_many_scans_are_coloured_as_a_pair_is(room):
    given, result = room
    view, away_m = group_viewer(given, result, Lengths("mm"), 9000)
    for name in ("own colours", "residual", "curvature", "class", "Skip-map", "feature voxels"):
        assert name in view
    assert '"name": "mm"' in view
    voxel_size_m = next(iter(result.pairs.values())).voxel_size_m
    assert (away_m <= voxel_size_m).all() and np.median(away_m) < voxel_size_m / 2


def test_a_scan_in_doubt_is_shown_at_each_of_its_places_and_nowhere_else(room):
    given, result = room
    assert result.groups == [[0, 1, 2]]
    places = [Place(0, result.T_group_scan[2]), Place(0, np.eye(4)), Place(1, np.eye(4))]
    doubtful = replace(result, groups=[[0, 1], [2]], places={2: places})
    view, _ = group_viewer(given, doubtful, Lengths(), 9000)
    [text] = re.findall(r'class="scans">(.*?)</script>', view)
    poses = json.loads(text)["poses"]
    assert [pose["matrices"][2] is None for pose in poses] == [True, False, False, False]
    assert "scan 2, place 2" in view and "scan 2, place 3" not in view
