"""The search for the configuration in which most agrees, with planted proposals and a judge."""

from __future__ import annotations

import numpy as np
import pytest
from test_groups import STRICT, Plan, near

from skipnet.geometry import invert, make_transform, pose_error
from skipnet.projects.alternatives import common_parts, in_parts
from skipnet.projects.configurations import Configuration
from skipnet.projects.groups import Group, Joiner
from skipnet.projects.orders import configurations

ASIDE = make_transform(np.eye(3), np.array([0.0, 9.0, 0.0]))


def placed(plan, scans, moved=()):
    """Scans where they are, some of them 9 m aside, with what agrees between neighbours."""
    poses = {s: plan.true(0, s) for s in scans}
    poses |= {s: ASIDE @ poses[s] for s in moved}
    together = {(a, b) for a in scans for b in scans if a < b and (a in moved) == (b in moved)}
    shares = {(a, b): {1: 0.3, 2: 0.2}.get(b - a, 0.0) for a, b in together}
    return Configuration((poses,), {k: v for k, v in shares.items() if v}, {})


def test_all_scans_are_found_where_they_are_however_the_first_joins_mislead():
    """A third scan's wrong place agrees more with one other than any right one, and costs it
    the others."""

    class Misleading(Plan):
        def pair(self, target, source, T):
            found = super().pair(target, source, T)
            for row, one in enumerate(T):
                if (target, source) == (0, 3) and max(pose_error(one, wrong)) < 0.05:
                    found[:, row] = 0.5, 0.0
            return found

    plan = Misleading(6)
    wrong = plan.true(0, 1) @ make_transform(np.eye(3), np.array([0.0, 0.0, 40.0]))
    proposals = plan.proposals(near(6))
    proposals[0, 3] = plan.proposal((0, 3), [wrong])
    best, *others = configurations(range(6), proposals, plan, STRICT)
    assert [group.scans for group in best.groups] == [[0, 1, 2, 3, 4, 5]]
    assert best.merit == pytest.approx(5 * 0.3 + 4 * 0.2)
    for scan in range(6):
        T = invert(best.groups[0].poses[0]) @ best.groups[0].poses[scan]
        np.testing.assert_allclose(T, plan.true(0, scan), atol=1e-9)
    again = configurations(range(6), proposals, plan, STRICT)
    for scan, T in best.groups[0].poses.items():
        np.testing.assert_array_equal(again[0].groups[0].poses[scan], T)
    assert [one.merit for one in again] == [one.merit for one in (best, *others)]


def test_a_search_goes_on_from_what_was_found_when_less_was_proposed():
    plan = Plan(6)
    proposals = plan.proposals([key for key in near(6) if 5 not in key])
    known = configurations(range(6), proposals, plan, STRICT)
    assert [group.scans for group in known[0].groups] == [[0, 1, 2, 3, 4], [5]]
    again = configurations(range(6), plan.proposals(near(6)), plan, STRICT, known)
    assert [group.scans for group in again[0].groups] == [[0, 1, 2, 3, 4, 5]]
    assert again[0].merit == pytest.approx(5 * 0.3 + 4 * 0.2)
    merits = [one.merit for one in again]
    assert merits == sorted(merits, reverse=True)


def test_nothing_is_joined_that_any_scan_contradicts():
    plan = Plan(4)
    lies = {(0, 1): plan.proposal((0, 1), [plan.true(0, 1) @ ASIDE])}
    best, *_ = configurations(range(4), lies, plan, STRICT)
    assert [len(group.poses) for group in best.groups] == [1, 1, 1, 1]


def test_scans_that_another_configuration_puts_elsewhere_about_as_well_are_parted():
    plan = Plan(6)
    joiner = Joiner(plan.proposals(near(6)), plan)
    best = placed(plan, range(6))
    assert best.merit == pytest.approx(2.3)

    def with_merit(merit, moved):
        other = placed(plan, range(6), moved)
        return Configuration(other.poses, {**other.shares, (0, 1): merit - other.merit + 0.3}, {})

    # The last agrees with two others by 0.5 in all.
    assert sorted(common_parts(best, [with_merit(2.2, [5])], joiner)) == [[0, 1, 2, 3, 4], [5]]
    assert sorted(common_parts(best, [with_merit(2.0, [5])], joiner)) == [[0, 1, 2, 3, 4, 5]]
    # Two halves that may be turned against each other stay as halves.
    assert sorted(common_parts(best, [with_merit(2.2, [3, 4, 5])], joiner)) == [
        [0, 1, 2],
        [3, 4, 5],
    ]


def test_what_is_wrong_does_not_hide_behind_what_may_as_well_be_so():
    """The first scan may stand elsewhere; that it does so makes no other wrong place as good."""
    plan = Plan(8)
    joiner = Joiner(plan.proposals(near(8)), plan)
    best = placed(plan, range(8))

    def other(merit, moved):
        made = placed(plan, range(8), moved)
        return Configuration(made.poses, {**made.shares, (3, 4): merit - made.merit + 0.3}, {})

    free = other(best.merit, [0])
    both = other(best.merit - 0.3, [0, 7])  # 0.3 of 0.5, which is too much for the last one alone
    assert sorted(common_parts(best, [free, both], joiner)) == [[0], [1, 2, 3, 4, 5, 6, 7]]
    assert sorted(common_parts(best, [both], joiner)) == [[0, 7], [1, 2, 3, 4, 5, 6]]


def test_what_joins_late_joins_a_part_and_brings_no_doubtful_scan_along():
    """Five scans stood together, of which the last is in doubt; of three that joined late, one."""
    plan = Plan(8)
    poses = {s: plan.true(0, s) for s in range(8)}
    best = Configuration(
        tuple({s: poses[s] for s in some} for some in (range(5), range(5, 8))), {}, {}
    )
    joiner = Joiner(plan.proposals(near(8)), plan)
    part_of = {**dict.fromkeys(range(4), 0), 4: 1, 5: 2, 6: 2, 7: 3}
    parts = in_parts(Group(poses), best, part_of, joiner)
    # The late pair shares 0.5 with the doubtful one, and 0.2 with the others.
    assert sorted(part.scans for part in parts) == [[0, 1, 2, 3], [4, 5, 6], [7]]


def test_what_another_configuration_only_left_apart_is_not_in_doubt():
    plan = Plan(6)
    joiner = Joiner(plan.proposals(near(6)), plan)
    best = placed(plan, range(6))
    apart = Configuration(
        tuple({s: plan.true(k, s) for s in some} for k, some in ((0, range(4)), (4, (4, 5)))),
        {**best.shares, (1, 2): 0.29},
        {},
    )
    assert sorted(common_parts(best, [apart], joiner)) == [[0, 1, 2, 3, 4, 5]]
