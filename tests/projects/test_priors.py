"""What somebody believes of many scans: right, it helps; wrong, it makes no wrong result."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.geometry import invert, make_transform, pose_error, rotation_from_vector
from skipnet.projects.priors import Priors
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.simulation.scanning.pairs import simulate_scans

PLANES = RegistrationConfig(generators=[Generator.planes])


@pytest.fixture(scope="module")
def scans():
    return simulate_scans("paper_room", 1, 3, rotation="any", points=10_000)[0]


def true(scans, target, source):
    return invert(scans[target].T_world_sensor) @ scans[source].T_world_sensor


def assert_right(scans, T_group_scan):
    for scan in range(len(scans)):
        rotation_rad, translation_m = pose_error(T_group_scan[scan], true(scans, 0, scan))
        assert np.rad2deg(rotation_rad) < 0.5 and translation_m < 0.03


def test_wrong_priors_make_no_wrong_result(scans, tmp_path):
    clouds_m = [scan.points_m for scan in scans]
    off = make_transform(rotation_from_vector(np.array([0.0, 0.0, 1.5])), np.array([2.0, 1.0, 0.0]))
    priors = Priors(
        positions_m={0: (0, 0, 0), 1: (900, 0, 0), 2: (0, 900, 0)},
        links={(0, 1): skipnet.Prior(off @ true(scans, 0, 1), 0.01, 0.1)},
        non_links=[(0, 2)],
    )
    found = skipnet.register_many(clouds_m, priors=priors, folder=tmp_path)
    assert found.groups == [[0, 1, 2]]
    assert_right(scans, found.T_group_scan)
    again = skipnet.register_many(clouds_m, priors=priors, folder=tmp_path)
    np.testing.assert_array_equal(again.T_group_scan, found.T_group_scan)


def test_right_priors_help_where_planes_find_nothing():
    """Open terrain has no planes: by planes alone its scans find no place."""
    terrain = simulate_scans("terrain", 1, 3, rotation="any", points=50_000)[0]
    clouds_m = [scan.points_m for scan in terrain]
    alone = skipnet.register_many(clouds_m, config=PLANES)
    assert alone.groups == [[0], [1], [2]]
    slip = make_transform(rotation_from_vector(np.array([0.0, 0.0, 0.02])), np.full(3, 0.05))
    rough = {k: skipnet.Prior(slip @ true(terrain, 0, k), 0.1, 2.0) for k in (1, 2)}
    links = {(0, 1): rough[1], (2, 0): inverse(rough[2])}
    helped = skipnet.register_many(clouds_m, config=PLANES, priors=Priors(links=links))
    assert helped.groups == [[0, 1, 2]]
    assert_right(terrain, helped.T_group_scan)


def inverse(prior):
    T = invert(np.asarray(prior.T_target_source))
    return skipnet.Prior(T, prior.position_std_m, prior.rotation_std_deg)


def test_priors_of_poses_give_those_of_pairs_within_reach():
    poses = {
        s: skipnet.Prior(make_transform(np.eye(3), np.array([4.0 * s, 0, 0]))) for s in range(3)
    }
    found = Priors(poses=poses).guesses(reach_m=5.0)
    assert set(found) == {(0, 1), (1, 2)}
    np.testing.assert_allclose(np.asarray(found[0, 1].T_target_source)[:3, 3], [4, 0, 0])
    given = Priors(positions_m={0: (0, 0, 0), 1: (30, 0, 0)}, position_std_m=1, non_links=[(2, 1)])
    assert given.is_hopeless((0, 1), 20.0) and not given.is_hopeless((0, 1), 28.0)
    assert given.is_hopeless((1, 2), 20.0) and not given.is_hopeless((0, 2), 20.0)


def test_priors_that_are_none_are_refused(scans):
    with pytest.raises(ValueError, match="there is no scan 7: got 3 scans"):
        clouds_m = [scan.points_m for scan in scans]
        skipnet.register_many(clouds_m, priors=Priors(non_links=[(0, 7)]))
    with pytest.raises(ValueError, match="scan 1 is linked with itself"):
        Priors(links={(1, 1): None})
    with pytest.raises(ValueError, match="position of scan 0"):
        Priors(positions_m={0: (1, 2)})
    with pytest.raises(ValueError, match="position_std_m"):
        Priors(position_std_m=0)
