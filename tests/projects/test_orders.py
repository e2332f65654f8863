"""Growing in other orders, with planted proposals and a planted judge."""

from __future__ import annotations

import numpy as np
import pytest
from test_groups import STRICT, Plan, near

from skipnet.geometry import invert, make_transform
from skipnet.projects.groups import Group, Joiner, merit
from skipnet.projects.orders import Search, elsewhere, in_many_orders


def chain(plan, scans):
    return Group({s: plan.true(scans[0], s) for s in scans}, 0.3)


def test_an_early_wrong_join_is_undone_by_another_order():
    """Begin with a wrong group: what is grown anew has more that agrees."""
    plan = Plan(6)
    joiner = Joiner(plan.proposals(near(6)), plan)
    wrong = [chain(plan, [0, 1]), chain(plan, [2, 3]), chain(plan, [4, 5])]
    search = in_many_orders(wrong, joiner, STRICT)
    assert [group.scans for group in search.best] == [[0, 1, 2, 3, 4, 5]]
    assert merit(search.best) == pytest.approx(5 * 0.3 + 4 * 0.2)
    again = in_many_orders(wrong, joiner, STRICT)
    for scan, T in search.best[0].poses.items():
        np.testing.assert_array_equal(again.best[0].poses[scan], T)


def test_scans_that_another_order_puts_elsewhere_about_as_well_are_in_doubt():
    plan = Plan(6)
    joiner = Joiner(plan.proposals(near(6)), plan)
    best = Group({s: plan.true(0, s) for s in range(6)}, 2.3)
    aside = make_transform(np.eye(3), np.array([0.0, 9.0, 0.0]))
    moved = Group({**best.poses, 5: best.poses[5] @ aside}, 2.25)
    assert elsewhere(Search([best], [[moved]]), joiner) == {5}
    much_worse = Group(moved.poses, 1.5)
    assert elsewhere(Search([best], [[much_worse]]), joiner) == set()


def test_what_another_order_only_left_apart_is_not_in_doubt():
    plan = Plan(6)
    joiner = Joiner(plan.proposals(near(6)), plan)
    best = Group({s: plan.true(0, s) for s in range(6)}, 2.3)
    parts = [
        Group({s: invert(best.poses[k]) @ best.poses[s] for s in some}, 1.149)
        for k, some in ((0, [0, 1, 2, 3]), (4, [4, 5]))
    ]
    assert elsewhere(Search([best], [parts]), joiner) == set()
