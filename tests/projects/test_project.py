"""Many scans: simulated rooms, planted pose graphs with known answers, scans of elsewhere."""

from __future__ import annotations

import json
from dataclasses import replace

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
from skipnet.projects.graph import Link, balance, closure_m, place, solve, spanning_tree
from skipnet.projects.project import register_many
from skipnet.results.project import poses_json, scans_page
from skipnet.simulation.scanning.pairs import simulate_pair, simulate_scans


@pytest.fixture(scope="module")
def scans():
    return simulate_scans("paper_room", 1, 4, rotation="any", points=25_000)[0]


@pytest.fixture(scope="module")
def result(scans):
    return register_many([scan.points_m for scan in scans])


def truth(scans, target, source):
    return invert(scans[target].T_world_sensor) @ scans[source].T_world_sensor


def test_every_scan_of_a_room_finds_its_place_and_every_pair_is_told(scans, result):
    assert result.status == "registered" and "all 4 scans" in result.reason
    assert set(result.pairs) == {(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)}
    np.testing.assert_array_equal(result.T_first_scan[0], np.eye(4))
    for number, T in enumerate(result.T_first_scan):
        rotation_rad, translation_m = pose_error(T, truth(scans, 0, number))
        assert np.rad2deg(rotation_rad) < 0.05 and translation_m < 0.003
    assert not result.rejected
    assert set(result.closures_m) == set(result.pairs)
    assert max(result.closures_m.values()) < 0.005
    assert list(result.timings_s) == ["skip-map", "pairs", "pose graph"]


def test_a_pair_comes_out_as_from_register(scans, result):
    import skipnet

    size_m = float(str(result.pairs[0, 1].details["voxel_size_m"]))
    alone = skipnet.register(scans[1].points_m, scans[0].points_m, voxel_size_m=size_m)
    np.testing.assert_allclose(result.pairs[0, 1].T_target_source, alone.T_target_source, atol=1e-9)


def test_the_balanced_poses_are_better_than_the_pairs_on_average(scans, result):
    T_first_scan = result.T_first_scan
    pairs_m, balanced_m = [], []
    for (target, source), pair in result.pairs.items():
        T_true = truth(scans, target, source)
        pairs_m.append(pose_error(pair.T_target_source, T_true)[1])
        T_balanced = invert(T_first_scan[target]) @ T_first_scan[source]
        balanced_m.append(pose_error(T_balanced, T_true)[1])
    assert np.sqrt(np.mean(np.square(balanced_m))) < np.sqrt(np.mean(np.square(pairs_m)))


def test_a_scan_that_fits_nowhere_for_sure_has_no_pose_and_is_named(scans):
    lone_wall_m = np.random.default_rng(0).uniform([2, -2, -1], [2, 2, 1], size=(20_000, 3))
    clouds_m = [scans[0].points_m, lone_wall_m, scans[1].points_m]
    result = register_many(clouds_m)
    assert result.status == "failed" and "scan 1 with scan 0" in result.reason
    assert result.T_first_scan[1] is None
    rotation_rad, translation_m = pose_error(result.T_first_scan[2], truth(scans, 0, 1))
    assert np.rad2deg(rotation_rad) < 0.5 and translation_m < 0.03
    assert set(result.closures_m) == {(0, 2)} and len(result.pairs) == 3


# --- the pose graph by itself ---------------------------------------------------------------------


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
        T = change @ invert(poses[target]) @ poses[source]
        centre_m = rng.normal(size=3)
        links[target, source] = Link(T, centre_m, np.eye(6) if information is None else information)
    return links


LOOP = [(0, 1), (1, 2), (2, 3), (0, 3), (0, 2)]


def test_the_tree_agrees_with_scipys_and_stops_at_what_it_cannot_reach():
    from scipy.sparse.csgraph import minimum_spanning_tree

    rng = np.random.default_rng(0)
    keys = [(i, j) for i in range(9) for j in range(i + 1, 9) if rng.random() < 0.6]
    trust = {key: (float(rng.random()), 0.0) for key in keys}
    cost = np.zeros((9, 9))
    for key in keys:
        cost[key] = 2 - trust[key][0]
    expected = list(zip(*minimum_spanning_tree(cost).nonzero(), strict=True))
    assert sorted(spanning_tree(trust)) == sorted((int(i), int(j)) for i, j in expected)
    assert spanning_tree({(1, 2): (1.0,)}) == []


def test_places_follow_the_tree_in_either_direction():
    poses = random_poses(4)
    keys = [(0, 2), (1, 2), (1, 3)]
    placed = place(keys, links_of(poses, keys))
    for scan, T in poses.items():
        np.testing.assert_allclose(placed[scan], T, atol=1e-12)


def test_exact_links_give_the_exact_poses_from_a_disturbed_start():
    poses = random_poses(4)
    links = links_of(poses, LOOP)
    rng = np.random.default_rng(2)
    start = {
        scan: make_transform(rotation_from_vector(rng.normal(scale=0.05, size=3)), np.zeros(3)) @ T
        if scan
        else T
        for scan, T in poses.items()
    }
    balanced = balance(start, links)
    for scan, T in poses.items():
        np.testing.assert_allclose(balanced[scan], T, atol=1e-5)
    for key, link in links.items():
        assert closure_m(link, key, balanced) < 1e-5


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
        poses = balance(place([(0, 1), (1, 2)], links), links)
        return [poses[scan][0, 3] for scan in (1, 2)]

    np.testing.assert_allclose(chain({}), [1.1, 2.2], atol=1e-6)
    # By hand: the gap of 0.3 m is shared in inverse proportion to the weights, 1 : 1 : 1/4.
    firm = {(0, 2): 4 * np.eye(6)}
    np.testing.assert_allclose(chain(firm), [1 + 0.3 * 4 / 9, 2.3 - 0.3 / 9], atol=1e-6)
    # A link that says nothing about x leaves the others alone.
    blind = {(0, 2): np.diag([1.0, 1, 1, 0, 1, 1])}
    np.testing.assert_allclose(chain(blind), [1.0, 2.0], atol=1e-6)


def test_a_pair_that_had_no_say_is_told_in_the_results(result):
    told = replace(result, rejected=[(0, 2)])
    pairs = {
        (pair["target"], pair["source"]): pair
        for pair in json.loads(poses_json(told, list("abcd"), 0))["pairs"]
    }
    assert [key for key, pair in pairs.items() if pair["rejected"]] == [(0, 2)]
    closures_m = {key: pair["closure_m"] for key, pair in pairs.items()}
    assert closures_m == {key: pytest.approx(m) for key, m in result.closures_m.items()}
    page = scans_page(told, list("abcd"), b"", 0)
    assert page.count("registered, rejected") == 1 and "pose graph" in page


def test_a_wrong_link_that_contradicts_more_trusted_ones_has_no_say():
    poses = random_poses(5)
    links = links_of(poses, [*LOOP, (3, 4)], noise=0.001)
    wrong = make_transform(np.eye(3), np.array([0.5, 0, 0])) @ links[0, 2].T_target_source
    links[0, 2] = Link(wrong, links[0, 2].centre_m, 1e6 * np.eye(6))
    links[6, 7] = links[0, 2]  # two scans that nothing connects with the others
    trust = {key: (0.9 if key == (0, 2) else 1.0,) for key in links}
    found, agreeing = solve(links, trust, limit_m=0.1)
    assert agreeing == {(0, 1), (1, 2), (2, 3), (0, 3), (3, 4)} and set(found) == set(range(5))
    for scan, T in poses.items():
        assert pose_error(found[scan], T)[1] < 0.05


def test_noise_averages_out_over_loops():
    poses = random_poses(6)
    keys = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    links = links_of(poses, keys, noise=0.01)
    tree = [(0, j) for j in range(1, 6)]
    chained, balanced = place(tree, links), balance(place(tree, links), links)

    def error_m(found):
        return np.sqrt(np.mean([pose_error(found[s], poses[s])[1] ** 2 for s in range(1, 6)]))

    assert error_m(balanced) < error_m(chained)


def test_a_deviation_is_measured_at_the_centre_of_the_overlap():
    centre_m = np.array([10.0, 0, 0])
    T = random_poses(2)[1]
    turn = make_transform(rotation_from_vector(np.array([0, 0, 0.01])), np.zeros(3))
    shift_m = transform_points(turn, centre_m[None])[0] - centre_m
    deviation = Link(T, centre_m, np.eye(6)).deviation(turn @ T)
    np.testing.assert_allclose(deviation, [0, 0, 0.01, *shift_m], atol=1e-12)


def test_bad_input_names_the_scan():
    cloud_m = simulate_pair("paper_room", 1, points=500).pair.source_m
    with pytest.raises(ValueError, match="got 1 scans: expected two or more"):
        register_many([cloud_m])
    with pytest.raises(ValueError, match=r"scans\[1\]: got 2 points"):
        register_many([cloud_m, cloud_m[:2]])
    with pytest.raises(ValueError, match="got 1 viewpoints for 2 scans"):
        register_many([cloud_m, cloud_m], viewpoints=[None])
    with pytest.raises(ValueError, match=r"viewpoints\[1\]=.* expected"):
        register_many([cloud_m, cloud_m], viewpoints=[None, [0.0, 1.0]])
