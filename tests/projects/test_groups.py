"""Groups by planted proposals: the judge's word is planted too, so every answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.geometry import (
    invert,
    make_transform,
    pose_error,
    random_rotation,
    rotation_from_vector,
)
from skipnet.projects import testimony
from skipnet.projects.arbiter import Arbiter
from skipnet.projects.builder import Builder, edges_of
from skipnet.projects.components import bridges, components
from skipnet.projects.configurations import all_alone
from skipnet.projects.doubts import Doubts
from skipnet.projects.firmness import PECULIAR
from skipnet.projects.groups import Group, Joiner, Proposals
from skipnet.projects.motions import rival_split
from skipnet.projects.sameness import leaders, same_place
from skipnet.projects.tightening import tightened
from skipnet.projects.ways import Standards, rivals
from skipnet.projects.witness import Witness
from skipnet.scans.describing import describe
from skipnet.simulation.scanning.pairs import simulate_scans

STRICT = Standards(limit=0.002, rival_support=0.4)


class Plan:
    """Scans on a line; those next to each other overlap, whatever else they see contradicts."""

    voxel_size_m = 0.1
    hopeless = np.inf

    def __init__(self, count, alike=(), step_m=3.0, seed=0):
        rng = np.random.default_rng(seed)
        self.poses = [
            make_transform(random_rotation(rng), np.array([step_m * k, 0.0, 0.0]))
            for k in range(count)
        ]
        self.centres_m = [np.zeros(3)] * count
        self._alike = {frozenset(pair) for pair in alike}
        self.narrow = set()

    def sees_all_round(self, scan):
        return scan not in self.narrow

    def same_station(self, target, source, T):
        return np.zeros(len(T), dtype=bool)

    def pair(self, target, source, T):
        """Overlap 0.3 of neighbours in their places, 0.2 of the next, 0.8 on each other."""
        found = np.zeros((2, len(T)))
        right = [
            self.true(t, s) for t in self._same_as(target) for s in self._same_as(source) if t != s
        ]
        for row, one in enumerate(T):
            apart = round(float(np.linalg.norm(one[:3, 3])) / 3.0, 3)
            if any(max(pose_error(one, T_true)) < 0.05 for T_true in right):
                found[:, row] = {1.0: 0.3, 2.0: 0.2}.get(apart, 0.0), 0.0
            elif apart < 0.1:
                is_alike = source in self._same_as(target)
                found[:, row] = 0.8, 0.0 if is_alike else 0.05
            elif apart < 6:
                found[:, row] = 0.1, 0.02
        return found

    def _same_as(self, scan):
        """The scan, and those that look the same and so may stand in its place."""
        return {scan} | {other for pair in self._alike if scan in pair for other in pair}

    def all_pairs(self, targets, sources, T, hopeless=None):
        said = np.array(
            [self.pair(a, b, invert(targets[a]) @ T @ sources[b]) for a in targets for b in sources]
        )
        overlap, excess = said[:, 0], said[:, 1]
        return testimony.Testimony(
            overlap.sum(0),
            excess.sum(0),
            excess.max(0),
            (overlap > 0.03).sum(0),
            overlap.max(0),
        )

    def about(self, targets, sources, T):
        for target, source, one in zip(targets, sources, T, strict=True):
            yield tuple(self.pair(target, source, one[None])[:, 0])

    def meeting(self, targets, T_targets, sources, T_sources):
        a, b = (one.ravel() for one in np.meshgrid(targets, sources, indexing="ij"))
        T_a, T_b = (np.repeat(T_targets, len(sources), 0), np.tile(T_sources, (len(targets), 1, 1)))
        turned = (a > b)[:, None, None]
        T_a, T_b = np.where(turned, T_b, T_a), np.where(turned, T_a, T_b)
        return np.minimum(a, b), np.maximum(a, b), invert(T_a) @ T_b

    def true(self, target, source):
        return invert(self.poses[target]) @ self.poses[source]

    def proposals(self, pairs, confidence=0.99):
        return {key: self.proposal(key, [self.true(*key)], confidence) for key in pairs}

    def proposal(self, key, poses, confidence=0.99):
        T = np.array(poses)
        overlap, violation = self.pair(*key, T)
        return Proposals(T, overlap, violation, confidence)


def as_it_is(group):
    """Alignment of planted scans, which are where they are."""
    return group


def nothing(group, key):
    """What stands out in planted scans."""
    return 0


def near(count, reach=2):
    return [(i, j) for i in range(count) for j in range(i + 1, min(i + 1 + reach, count))]


def test_right_proposals_make_one_group_in_true_places():
    plan = Plan(6)
    groups = Joiner(plan.proposals(near(6)), plan).grow(map(Group.single, range(6)), STRICT)
    assert [group.scans for group in groups] == [[0, 1, 2, 3, 4, 5]]
    for scan in range(6):
        T = invert(groups[0].poses[0]) @ groups[0].poses[scan]
        np.testing.assert_allclose(T, plan.true(0, scan), atol=1e-9)
    assert groups[0].support == pytest.approx(5 * 0.3 + 4 * 0.2)


def test_a_confident_wrong_pair_that_others_contradict_joins_nothing():
    plan = Plan(12)
    halves = [(a + k, b + k) for k in (0, 6) for a, b in near(6)]
    proposals = plan.proposals(halves)
    proposals[0, 11] = plan.proposal((0, 11), [np.eye(4)], 1.0)
    found = Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(12))
    assert [group.scans for group in found.groups] == [list(range(6)), list(range(6, 12))]


class Slipped(Plan):
    """A place that is some millimetres or milliradians off contradicts a little."""

    def pair(self, target, source, T):
        found = super().pair(target, source, T)
        T_true = self.true(target, source)
        off = [max(pose_error(one, T_true)) > 0.005 for one in T]
        found[1, (found[0] > 0) & np.array(off)] += 0.0015
        return found


def test_a_join_that_contradicts_only_until_all_are_aligned_is_made():
    plan = Slipped(6)
    proposals = plan.proposals([key for key in near(6) if key[1] < 3 or key[0] > 2])
    slip = make_transform(rotation_from_vector(np.array([0.0, 0.0, 0.008])), np.zeros(3))
    for a, b in ((2, 3), (2, 4), (1, 3)):
        T_slid = plan.true(a, 3) @ slip @ plan.true(3, b)
        proposals[a, b] = plan.proposal((a, b), [T_slid])
    joiner = Joiner(proposals, plan)
    halves = joiner.grow(map(Group.single, range(6)), STRICT)
    assert [group.scans for group in halves] == [[0, 1, 2], [3, 4, 5]]

    def settle(group):
        return Group({scan: plan.true(group.scans[0], scan) for scan in group.scans})

    groups = tightened(halves, joiner, settle, STRICT)
    assert [group.scans for group in groups] == [[0, 1, 2, 3, 4, 5]]
    np.testing.assert_allclose(groups[0].poses[5], plan.true(0, 5), atol=1e-9)
    left = tightened(halves, joiner, as_it_is, STRICT)
    assert [group.scans for group in left] == [[0, 1, 2], [3, 4, 5]]


def test_scans_of_alike_rooms_that_lie_on_each_other_are_not_believed():
    plan = Plan(4, alike=[(0, 3)])
    arbiter = Arbiter(Joiner({}, plan), as_it_is, nothing)
    laid = Group({0: np.eye(4), 1: np.eye(4)})
    assert arbiter._lies_on_another([laid])  # see the same and contradict
    assert not arbiter._lies_on_another([Group({0: np.eye(4), 3: np.eye(4)})])
    assert not arbiter._lies_on_another([Group({s: plan.poses[s] for s in range(4)})])


def test_scans_that_see_the_same_where_much_looks_alike_are_in_doubt_and_where_they_fit_is_told():
    plan = Plan(8, alike=[(0, 7)])
    proposals = plan.proposals(near(7))
    # Scan 7 has scan 0's place, and one beyond scan 6, where it is in truth.
    proposals[0, 7] = plan.proposal((0, 7), [np.eye(4)], 1.0)
    proposals[6, 7] = plan.proposal((6, 7), [plan.true(6, 7)], 0.9)
    for key in ((1, 3), (2, 4), (3, 5)):  # much looks alike here: these are wrong
        astray = plan.true(*key) @ make_transform(np.eye(3), np.ones(3))
        proposals[key] = plan.proposal(key, [astray], 0.9)
    found = Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(8))
    assert found.reliability < 0.9
    assert [group.scans for group in found.groups] == [[1, 2, 3, 4, 5, 6], [0], [7]]
    assert found.places[0] and found.places[7]


def test_rivals_are_those_that_agree_as_much_and_contradict_as_little():
    def way(support, contradiction, closest=0.3):
        from skipnet.projects.ways import Way

        return Way(np.eye(4), frozenset({(0, 1)}), 0.9, support, contradiction, 1, closest)

    best, close, weak, contradicted = way(0.5, 0.0), way(0.3, 0.0), way(0.1, 0.0), way(0.9, 0.01)
    assert rivals([weak, close, contradicted, best], STRICT) == [best, close]
    assert rivals([contradicted], STRICT) == []
    same = way(0.95, 0.0, closest=0.95)
    assert rivals([same, best], STRICT) == [same, best]


def test_a_half_that_may_be_turned_is_found_by_the_motion_that_pairs_ask_for():
    plan = Plan(4)
    group = Group({scan: invert(plan.poses[0]) @ plan.poses[scan] for scan in range(4)})
    assert rival_split(group, Joiner(plan.proposals(near(4)), plan), STRICT) is None
    # The second half laid against the first in another way, which nobody contradicts either.
    shift = make_transform(np.eye(3), np.array([0.0, 40.0, 0.0]))
    other = {0: np.eye(4), 1: np.eye(4), 2: shift, 3: shift}

    class Turnable(Plan):
        def pair(self, target, source, T):
            found = super().pair(target, source, T)
            moved = (
                invert(other[target] @ group.poses[target]) @ other[source] @ group.poses[source]
            )
            for row, one in enumerate(T):
                if pose_error(one, moved)[1] < 0.05 and target // 2 != source // 2:
                    found[:, row] = 0.25, 0.0
            return found

    turnable = Turnable(4)
    proposals = turnable.proposals(near(4))
    for a, b in ((1, 2), (0, 2), (1, 3)):
        moved = invert(other[a] @ group.poses[a]) @ other[b] @ group.poses[b]
        proposals[a, b] = turnable.proposal((a, b), [turnable.true(a, b), moved])
    split = rival_split(group, Joiner(proposals, turnable), STRICT)
    assert split is not None and sorted(map(sorted, split)) == [[0, 1], [2, 3]]


def test_leaders_are_the_first_of_those_about_the_same():
    rng = np.random.default_rng(0)
    turn = random_rotation(rng)
    places = [[0.0, 0, 0], [0.05, 0, 0], [3.0, 0, 0], [0.0, 0.02, 0]]
    T = np.array([make_transform(turn, np.array(place)) for place in places])
    assert leaders(T, np.ones(3), 0.1).tolist() == [0, 0, 2, 0]


def test_a_scan_of_which_too_few_others_say_too_little_is_not_believed():
    plan = Plan(9)
    poses = {scan: invert(plan.poses[0]) @ plan.poses[scan] for scan in range(9)}
    joiner = Joiner(plan.proposals(near(9)), plan)

    def parts(*scans):
        groups = [Group({scan: poses[scan] for scan in part}) for part in scans]
        found = Doubts(joiner, STRICT, holds=False, telling=nothing).sure_parts(groups)
        return [group.scans for group in found if len(group.poses) > 1]

    assert parts(range(6)) == [[0, 1, 2, 3, 4, 5]]
    assert parts([0, 1]) == []  # a pair alone
    # The last overlaps with one other by 0.2, then by 0.3.
    assert parts([0, 1, 2, 4]) == [[0, 1, 2]]
    assert parts([0, 1, 2, 3]) == [[0, 1, 2, 3]]
    assert parts([0, 1, 3]) == []
    # The first and the last have one each, by 0.3, and so has nobody else more than 0.2.
    assert parts([0, 1, 3, 4]) == []
    joiner = Joiner(plan.proposals(near(9), confidence=0.0), plan)
    assert parts(range(6)) == [[0, 1, 2, 3, 4, 5]]


def test_scans_of_which_little_is_said_stand_with_those_they_agree_with_in_what_only_they_have():
    plan = Plan(9)
    poses = {scan: invert(plan.poses[0]) @ plan.poses[scan] for scan in range(9)}
    joiner = Joiner(plan.proposals(near(9)), plan)

    def parts(scans, *tied):
        def telling(group, key):
            return PECULIAR if key in tied else PECULIAR - 1

        doubts = Doubts(joiner, STRICT, holds=False, telling=telling)
        found = doubts.sure_parts([Group({scan: poses[scan] for scan in scans})])
        assert sorted(scan for group in found for scan in group.poses) == sorted(scans)
        return [group.scans for group in found if len(group.poses) > 1]

    # The last overlaps with the third alone, by 0.2.
    assert parts([0, 1, 2, 4]) == [[0, 1, 2]]
    assert parts([0, 1, 2, 4], (2, 4)) == [[0, 1, 2, 4]]
    assert parts([0, 1, 2, 4], (1, 4)) == [[0, 1, 2]]  # which share nothing
    # Two that nobody else speaks for stand with each other.
    assert parts([0, 1], (0, 1)) == [[0, 1]]
    assert parts([0, 1, 2, 4, 6], (4, 6)) == [[0, 1, 2], [4, 6]]
    # Two blocks of three that only one pair holds together, by 0.2.
    assert parts([0, 1, 2, 4, 5, 6]) == [[0, 1, 2], [4, 5, 6]]
    assert parts([0, 1, 2, 4, 5, 6], (2, 4)) == [[0, 1, 2, 4, 5, 6]]


def test_the_same_place_is_what_follows_a_leader():
    plan, rng = Plan(6), np.random.default_rng(5)
    T = np.stack([plan.poses[0]] * 200)
    T[:, :3, 3] += rng.normal(scale=0.1, size=(200, 3))
    for one in T[::2]:
        one[:3, :3] = rotation_from_vector(rng.normal(scale=0.015, size=3)) @ one[:3, :3]
    expected = [leaders(np.stack([T[0], one]), np.zeros(3), 0.3)[1] == 0 for one in T]
    np.testing.assert_array_equal(same_place(plan, 0, T[0], T), expected)
    np.testing.assert_array_equal(same_place(plan, [0] * 200, T, T[0]), expected)
    assert 20 < sum(expected) < 180


def test_a_builder_that_knows_what_was_objected_to_builds_what_a_fresh_one_does():
    plan = Plan(10, alike=[(2, 8)])
    proposals = {**plan.proposals(near(10, 3)), (2, 9): plan.proposal((2, 9), [plan.true(8, 9)])}
    edges = edges_of(proposals, plan, STRICT)
    used, alone = Builder(edges, plan, STRICT), all_alone(range(10))
    for seed in range(12):
        again = used.build(alone, np.random.default_rng(seed))
        fresh = Builder(edges, plan, STRICT).build(alone, np.random.default_rng(seed))
        assert again.shares == fresh.shares
        assert [sorted(one) for one in again.poses] == [sorted(one) for one in fresh.poses]
    assert (used._objected >= 0).any(), "something was refused"


def test_a_refuted_pose_is_told_by_the_first_pairs_as_by_all():
    scans = simulate_scans("paper_room", 5, 4, points=20_000)[0]
    described = describe([one.points_m for one in scans], ["auto"] * 4)
    witness = Witness([one.evidence for one in described])
    own = [s.T_world_sensor @ d.T_given_own for s, d in zip(scans, described, strict=True)]
    halves = {0: own[0], 1: own[1]}, {2: own[2], 3: own[3]}
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, :2, 3] = [[0, 0], [0.02, 0], [0.1, 0.1], [1, 0], [0, 2], [90, 0]]
    whole = witness.all_pairs(*halves, T).contradiction
    limit = 0.002
    first = witness.all_pairs(*halves, T, limit).contradiction
    np.testing.assert_array_equal(first > limit, whole > limit)
    np.testing.assert_array_equal(first[whole <= limit], whole[whole <= limit])
    assert 0 < np.sum(whole > limit) < len(T)


def test_narrow_views_are_joined_by_pairs_that_are_sure():
    plan = Plan(6)
    poses = {scan: invert(plan.poses[0]) @ plan.poses[scan] for scan in range(6)}
    proposals = plan.proposals(near(6), confidence=0.99)
    for key in ((2, 3), (2, 4), (1, 3)):  # what joins the halves
        proposals[key] = replace(proposals[key], confidence=0.6)

    def parts():
        doubts = Doubts(Joiner(proposals, plan), STRICT, holds=True, telling=nothing)
        return [group.scans for group in doubts.sure_parts([Group(poses)])], doubts.unsure

    assert parts() == ([[0, 1, 2, 3, 4, 5]], {})
    plan.narrow = set(range(6))
    found, unsure = parts()
    assert found == [[0, 1, 2], [3, 4, 5]]
    assert set(unsure) <= {(2, 3), (2, 4), (1, 3)} and (2, 3) in unsure
    np.testing.assert_allclose(unsure[2, 3], plan.true(2, 3), atol=1e-9)
    plan.narrow = {0, 1, 2, 4, 5}  # scan 3 would see it if it stood elsewhere
    assert parts() == ([[0, 1, 2, 3, 4, 5]], {})


def test_narrow_views_that_a_sure_pair_puts_elsewhere_are_in_doubt():
    plan = Plan(8)
    plan.narrow = set(range(8))
    proposals = plan.proposals(near(8))
    assert Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(8)).groups[0].scans == [
        *range(8)
    ]
    proposals[0, 7] = plan.proposal((0, 7), [plan.true(0, 1)], 1.0)
    found = Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(8))
    # Two pairs hold each of both ends, and three or four the scans between.
    assert [group.scans for group in found.groups] == [[1, 2, 3, 4, 5, 6], [0], [7]]


def test_narrow_views_are_all_in_doubt_where_their_pairs_do_not_hold():
    plan = Plan(6)
    plan.narrow = set(range(6))
    proposals = plan.proposals(near(6))
    for key in ((0, 2), (1, 3), (2, 4)):  # of nine pairs a third are wrong
        astray = plan.true(*key) @ make_transform(np.eye(3), np.ones(3))
        proposals[key] = plan.proposal(key, [astray], 0.99)
    found = Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(6))
    assert found.reliability == pytest.approx(6 / 9)
    assert [group.scans for group in found.groups] == [[scan] for scan in range(6)]
    plan.narrow = set()
    assert len(Arbiter(Joiner(proposals, plan), as_it_is, nothing).decide(range(6)).groups) < 6


def test_twins_that_fit_in_each_others_places_are_both_left_out():
    plan = Plan(12, alike=[(2, 8)])
    poses = {scan: invert(plan.poses[0]) @ plan.poses[scan] for scan in range(12)}
    proposals = plan.proposals(near(12))
    doubts = Doubts(Joiner(proposals, plan), STRICT, holds=False, telling=nothing)
    assert doubts.sure_parts([Group(poses)])[0].scans == list(range(12))
    proposals[2, 8] = plan.proposal((2, 8), [np.eye(4)])
    doubts = Doubts(Joiner(proposals, plan), STRICT, holds=False, telling=nothing)
    found = [group.scans for group in doubts.sure_parts([Group(poses)])]
    assert [2] in found and [8] in found and [3, 4, 5, 6, 7] in found


def test_few_pairs_that_all_hold_are_no_proof_that_pairs_can_be_believed():
    plan = Plan(12)
    few = {**plan.proposals(near(12), confidence=0.0), **plan.proposals([(0, 1), (4, 5), (7, 8)])}
    found = Arbiter(Joiner(few, plan), as_it_is, nothing)
    assert found._loops(list(range(12))) == 0
    assert (
        Arbiter(Joiner(plan.proposals(near(12)), plan), as_it_is, nothing)._loops(list(range(12)))
        == 21 - 12 + 1
    )


def test_components_are_those_that_scipy_finds():
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rng = np.random.default_rng(1)
    edges = [(i, j) for i in range(12) for j in range(i + 1, 12) if rng.random() < 0.12]
    rows, columns = np.array(edges).T
    count = connected_components(coo_matrix((np.ones(len(edges)), (rows, columns)), (12, 12)))[0]
    assert len(components(range(12), edges)) == count > 1


def test_bridges_are_the_edges_without_which_a_graph_comes_apart():
    rng = np.random.default_rng(8)
    for count in (1, 2, 5, 9, 9, 9):
        drawn = rng.integers(0, count, size=(count + 3, 2))
        edges = sorted({(int(min(e)), int(max(e))) for e in drawn if e[0] != e[1]})
        whole = len(components(range(count), edges))
        needed = [
            edge
            for edge in edges
            if len(components(range(count), [one for one in edges if one != edge])) > whole
        ]
        assert bridges(range(count), edges) == needed
