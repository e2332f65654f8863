"""What stands out in alike rooms tells which room it is; what all of them have does not."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import invert, make_transform
from skipnet.networks.catalog import find_network
from skipnet.projects.firmness import PECULIAR
from skipnet.projects.groups import Group, Joiner, Proposals
from skipnet.projects.peculiarities import Peculiarities
from skipnet.projects.witness import Witness
from skipnet.scans.describing import describe

SIZE_M = np.array([5.0, 4.0, 2.6])
DOOR = ((2.2, 3.4, 0.0), (3.2, 4.0, 2.1))
"""A box that every room has, as a recess with a frame would be."""
FURNITURE = (
    ((0.6, 0.6, 0.0), (1.8, 1.3, 0.8)),
    ((3.0, 0.5, 0.0), (3.8, 1.6, 1.4)),
    ((0.5, 2.4, 0.0), (1.3, 3.2, 1.1)),
    ((3.6, 2.0, 0.0), (4.4, 2.6, 0.5)),
)
PLACES_M = ([2.5, 1.9, 1.4], [1.6, 1.8, 1.5], [2.4, 2.0, 1.3], [2.6, 1.8, 1.5], [2.5, 2.1, 1.4])
"""The first two are in one room."""
ROOM_OF = (0, 0, 1, 2, 3)


def box_m(low_m, high_m, step_m=0.03):
    """Points on the faces of a box."""
    low_m, high_m = np.array(low_m), np.array(high_m)
    faces = []
    for axis in range(3):
        a, b = (np.arange(low_m[k], high_m[k], step_m) for k in range(3) if k != axis)
        for at_m in (low_m[axis], high_m[axis]):
            faces.append(np.insert(np.stack(np.meshgrid(a, b), -1).reshape(-1, 2), axis, at_m, 1))
    return np.concatenate(faces)


@pytest.fixture(scope="module")
def peculiarities():
    """Scans of four rooms alike but for one piece of furniture in each, laid on each other."""
    rng = np.random.default_rng(0)
    clouds_m = []
    for place_m, room in zip(PLACES_M, ROOM_OF, strict=True):
        points_m = np.concatenate([box_m([0, 0, 0], SIZE_M), box_m(*DOOR), box_m(*FURNITURE[room])])
        clouds_m.append(points_m + rng.normal(scale=0.002, size=points_m.shape) - place_m)
    scans = describe(clouds_m, [np.zeros(3)] * 5, 0.1, 0, find_network("small", "cpu"))
    T_room_own = [
        make_transform(np.eye(3), np.array(place_m)) @ scan.T_given_own
        for place_m, scan in zip(PLACES_M, scans, strict=True)
    ]
    proposals = {}
    for a in range(5):
        for b in range(a + 1, 5):
            T = invert(T_room_own[a]) @ T_room_own[b]
            proposals[a, b] = Proposals(T[None], np.array([0.6]), np.zeros(1), 0.0)
    joiner = Joiner(proposals, Witness([scan.evidence for scan in scans]))
    return Peculiarities(scans, joiner), T_room_own


def test_what_only_one_room_has_agrees_between_its_scans_alone(peculiarities):
    compared, T_room_own = peculiarities
    one_room = Group({0: T_room_own[0], 1: T_room_own[1]})
    assert compared.agreeing(one_room, (0, 1)) >= PECULIAR
    # The scan of another room in its place: walls and door agree as well.
    another = Group({0: T_room_own[0], 2: T_room_own[2]})
    assert compared.agreeing(another, (0, 2)) < 0, "furniture is missing that was looked through"


def test_where_nobody_else_looks_alike_nothing_is_known_of_what_is_common(peculiarities):
    compared, T_room_own = peculiarities
    everywhere = Group(dict(enumerate(T_room_own)))  # all stand where they look alike
    assert compared.agreeing(everywhere, (0, 1)) == 0
