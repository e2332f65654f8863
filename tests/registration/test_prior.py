"""A prior is judged like any other hypothesis: it helps where it is right, and never decides."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.geometry import invert, make_transform, pose_error
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.prior import Prior, poses_about
from skipnet.simulation.scanning.pairs import simulate_pair


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=40_000).pair


def turned(angle_rad, shift_m):
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return make_transform(np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]), shift_m)


def test_a_right_prior_is_confirmed_and_a_wrong_one_named(pair):
    T = pair.T_target_source
    for prior, word in (
        (turned(0.02, [0.1, 0, 0]) @ T, "within what the prior allows"),
        (turned(np.pi, [1.0, 2, 0]) @ T, "not where the prior says"),
    ):
        result = skipnet.register(pair.source_m, pair.target_m, prior=prior)
        rotation_rad, translation_m = pose_error(result.T_target_source, T)
        assert result.status == "registered" and rotation_rad < 0.01 and translation_m < 0.03
        assert word in result.reason and result.details["prior_off_m"] > 0


def test_a_prior_is_found_again_where_nothing_else_proposes(pair):
    """Generators that see nothing here leave the prior alone; it is judged, aligned and named."""
    config = RegistrationConfig(generators=[Generator.corners])
    T = pair.T_target_source
    prior = Prior(turned(0.03, [0.15, -0.1, 0.05]) @ T, position_std_m=0.2, rotation_std_deg=2)
    result = skipnet.register(pair.source_m, pair.target_m, prior=prior, config=config)
    rotation_rad, translation_m = pose_error(result.T_target_source, T)
    assert rotation_rad < 0.01 and translation_m < 0.03


def test_swapped_scans_take_the_inverse_of_the_prior(pair):
    T = pair.T_target_source
    there = skipnet.register(pair.source_m, pair.target_m, prior=T)
    back = skipnet.register(pair.target_m, pair.source_m, prior=invert(T))
    np.testing.assert_allclose(back.T_target_source, invert(there.T_target_source), atol=1e-6)


def test_poses_about_a_prior_begin_with_it_and_spread_as_it_may_be_off():
    centre_m = np.array([3.0, 1, 0])
    prior = Prior(turned(0.5, [1, 2, 3]), position_std_m=0.5, rotation_std_deg=0)
    poses = poses_about(prior, centre_m, 0.1)
    np.testing.assert_allclose(poses[0], prior.T_target_source)
    off_m = (poses @ np.append(centre_m, 1) - poses[0] @ np.append(centre_m, 1))[1:, :3]
    assert abs(off_m.std() - 0.5) < 0.1
    np.testing.assert_allclose(poses[:, :3, :3], np.broadcast_to(poses[0][:3, :3], (96, 3, 3)))


@pytest.mark.parametrize(
    "prior", [np.eye(3), 2 * np.eye(4), np.full((4, 4), np.nan), np.diag([1.0, 1, -1, 1])]
)
def test_what_is_no_pose_is_refused(pair, prior):
    with pytest.raises(ValueError, match="prior: "):
        skipnet.register(pair.source_m, pair.target_m, prior=prior)
