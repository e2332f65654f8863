"""The study of many scans: what counts as misplaced, and what could be decided."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, make_transform
from skipnet.projects.project import Project
from skipnet.simulation.scanning.floors import ScannedFloor
from skipnet.simulation.scanning.pairs import simulate_scans
from skipnet.studies.decidable import decidable
from skipnet.studies.peers import chained
from skipnet.studies.projects import misplaced


@pytest.fixture(scope="module")
def room():
    scans = simulate_scans("paper_room", 1, 4, rotation="any", points=25_000)[0]
    return ScannedFloor(list(scans), [0, 0, 0, 0])


@pytest.fixture(scope="module")
def solved(room):
    project = Project()
    for scan in room.scans:
        project.add(scan.points_m)
    return project, project.solve()


def true_poses(room):
    first = invert(room.scans[0].T_world_sensor)
    return [first @ scan.T_world_sensor for scan in room.scans]


def test_a_scan_that_is_off_or_of_another_building_is_misplaced(room):
    T = true_poses(room)
    assert misplaced([[0, 1, 2, 3]], T, room) == []
    T[2] = make_transform(np.eye(3), np.array([0.03, 0.0, 0.0])) @ T[2]
    assert misplaced([[0, 1, 2, 3]], T, room) == [2]
    assert misplaced([[0, 1, 3], [2]], T, room) == []
    mixed = ScannedFloor(room.scans, [0, 0, 0, 1])
    assert misplaced([[0, 1, 2, 3]], true_poses(room), mixed) == [3]


def test_what_shares_enough_and_fits_nowhere_else_can_be_decided(room, solved):
    project, found = solved
    own = [
        scan.T_world_sensor @ described.T_given_own
        for scan, described in zip(room.scans, found.described, strict=True)
    ]
    assert decidable(project.joiner, own, room.building) == {0, 1, 2, 3}
    assert decidable(project.joiner, own, [0, 1, 2, 3]) == set()


def test_a_chain_takes_the_most_confident_pairs(room, solved):
    groups, T_group_scan = chained(solved[1].pairs, 4)
    assert groups == [[0, 1, 2, 3]] and misplaced(groups, T_group_scan, room) == []
    two = {key: pair for key, pair in solved[1].pairs.items() if 3 not in key}
    assert chained(two, 4)[0] == [[0, 1, 2], [3]]
