"""The pose graph: planted graphs with known answers, hand-worked loops, SciPy as a witness."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import (
    invert,
    make_transform,
    pose_error,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.projects.graph import Link, balance, closure_m, relative

LOOP = [(0, 1), (1, 2), (2, 3), (0, 3), (0, 2)]


def random_poses(count, seed=0):
    rng = np.random.default_rng(seed)
    poses = {0: np.eye(4)}
    for scan in range(1, count):
        poses[scan] = make_transform(random_rotation(rng), rng.normal(scale=5.0, size=3))
    return poses


def links_of(poses, keys, noise=0.0, seed=1, information=None):
    rng = np.random.default_rng(seed)
    links = {}
    for target, source in keys:
        change = make_transform(
            rotation_from_vector(rng.normal(scale=noise, size=3)), rng.normal(scale=noise, size=3)
        )
        T = change @ relative(poses, (target, source))
        links[target, source] = Link(
            T, rng.normal(size=3), np.eye(6) if information is None else information
        )
    return links


def disturbed(poses, scale, seed=2):
    rng = np.random.default_rng(seed)
    return {
        scan: make_transform(rotation_from_vector(rng.normal(scale=scale, size=3)), np.zeros(3)) @ T
        if scan
        else T
        for scan, T in poses.items()
    }


def test_exact_links_give_the_exact_poses_from_a_disturbed_start():
    poses = random_poses(4)
    links = links_of(poses, LOOP)
    found = balance(disturbed(poses, 0.05), links)
    for scan, T in poses.items():
        np.testing.assert_allclose(found.poses[scan], T, atol=1e-7)
    for key, link in links.items():
        assert closure_m(link, key, found.poses) < 1e-7
    assert set(found.weights.values()) == {1.0}


def test_a_contradiction_is_shared_by_what_each_link_determines():
    # Two scans 1 m apart say three links of a loop 0 -> 1 -> 2 -> 0 along x: 1 m, 1 m and 2.3 m.
    def shift(x_m):
        return make_transform(np.eye(3), np.array([x_m, 0, 0]))

    def chain(information):
        shifts_m = {(0, 1): 1.0, (1, 2): 1.0, (0, 2): 2.3}
        links = {
            key: Link(shift(x_m), np.zeros(3), information.get(key, np.eye(6)))
            for key, x_m in shifts_m.items()
        }
        poses = balance({0: shift(0), 1: shift(1), 2: shift(2)}, links).poses
        return [poses[scan][0, 3] for scan in (1, 2)]

    np.testing.assert_allclose(chain({}), [1.1, 2.2], atol=1e-6)
    # By hand: the gap of 0.3 m is shared in inverse proportion to the weights, 1 : 1 : 1/4.
    firm = {(0, 2): 4 * np.eye(6)}
    np.testing.assert_allclose(chain(firm), [1 + 0.3 * 4 / 9, 2.3 - 0.3 / 9], atol=1e-6)
    # A link that says nothing about x leaves the others alone.
    blind = {(0, 2): np.diag([1.0, 1, 1, 0, 1, 1])}
    np.testing.assert_allclose(chain(blind), [1.0, 2.0], atol=1e-6)


def test_it_finds_the_minimum_that_scipys_least_squares_finds():
    from scipy.optimize import least_squares

    poses = random_poses(5)
    information = np.diag([9.0, 4, 1, 2, 3, 5])
    links = links_of(poses, [*LOOP, (3, 4), (1, 4)], 0.001, information=information)
    root = np.sqrt(information)

    def moved(steps):
        result = {0: poses[0]}
        for scan, step in zip(range(1, 5), steps.reshape(-1, 6), strict=True):
            turned = rotation_from_vector(step[:3]) @ poses[scan][:3, :3]
            result[scan] = make_transform(turned, poses[scan][:3, 3] + step[3:])
        return result

    def residuals(steps):
        now = moved(steps)
        return np.concatenate(
            [root @ link.deviation(relative(now, key)) for key, link in links.items()]
        )

    expected = moved(least_squares(residuals, np.zeros(24), xtol=1e-12, ftol=1e-12).x)
    found = balance(poses, links).poses
    for scan, T in expected.items():
        np.testing.assert_allclose(found[scan], T, atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_links_have_no_say_and_are_named(seed):
    rng = np.random.default_rng(seed)
    poses = random_poses(20, seed)
    keys = [(i, j) for i in range(20) for j in range(i + 1, min(i + 5, 20))]
    links = links_of(poses, keys, 0.001, seed, 1e6 * np.eye(6))
    wrong = {keys[row] for row in rng.choice(len(keys), 7, replace=False) if keys[row][0] % 3}
    for key in wrong:
        astray = make_transform(random_rotation(rng), rng.normal(scale=2.0, size=3))
        links[key] = Link(astray @ links[key].T_target_source, np.zeros(3), 1e6 * np.eye(6))
    found = balance(disturbed(poses, 0.02, seed), links)
    unheard = {key for key, weight in found.weights.items() if weight < 0.5}
    assert unheard >= wrong and len(unheard - wrong) <= 1  # one that is hardly more than unlucky
    for scan, T in poses.items():
        assert pose_error(found.poses[scan], T)[1] < 0.02


def test_the_covariance_is_that_of_many_draws():
    poses = random_poses(4)
    information = 1e4 * np.eye(6)
    errors_m = []
    for seed in range(200):
        links = links_of(poses, LOOP, 0.01, seed, information)
        found = balance(poses, links)
        errors_m.append(found.poses[2][:3, 3] - poses[2][:3, 3])
    drawn_m = np.sqrt(np.trace(np.cov(np.array(errors_m).T)))
    claimed_m = np.sqrt(np.trace(found.covariances[2][3:, 3:]))
    assert 0.7 < drawn_m / claimed_m < 1.4
    assert not found.covariances[0].any()


def test_noise_averages_out_over_loops():
    poses = random_poses(6)
    keys = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    links = links_of(poses, keys, noise=0.01)
    chained = {0: np.eye(4)} | {j: links[0, j].T_target_source for j in range(1, 6)}

    def error_m(found):
        return np.sqrt(np.mean([pose_error(found[s], poses[s])[1] ** 2 for s in range(1, 6)]))

    assert error_m(balance(chained, links).poses) < error_m(chained)


def test_a_deviation_is_measured_at_the_centre_of_the_overlap():
    centre_m = np.array([10.0, 0, 0])
    T = random_poses(2)[1]
    turn = make_transform(rotation_from_vector(np.array([0, 0, 0.01])), np.zeros(3))
    shift_m = transform_points(turn, centre_m[None])[0] - centre_m
    deviation = Link(T, centre_m, np.eye(6)).deviation(turn @ T)
    np.testing.assert_allclose(deviation, [0, 0, 0.01, *shift_m], atol=1e-12)


def test_numbers_of_scans_need_not_begin_with_0_nor_be_all():
    poses = random_poses(3)
    links = links_of(poses, [(0, 1), (1, 2), (0, 2)])
    names = {0: 4, 1: 7, 2: 9}
    renamed = {(names[a], names[b]): link for (a, b), link in links.items()}
    found = balance({names[scan]: T for scan, T in disturbed(poses, 0.05).items()}, renamed)
    for scan, T in poses.items():
        np.testing.assert_allclose(found.poses[names[scan]], T, atol=1e-7)
    np.testing.assert_array_equal(invert(found.poses[4]), np.eye(4))
