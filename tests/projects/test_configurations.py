"""Configurations are kept packed, and come back as they were."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, rotation_from_vector
from skipnet.projects.configurations import Configuration, Found, Kept, Packed, all_alone


def drawn(rng, groups):
    """A configuration of some groups of scans, in the order that they are given in."""
    poses = tuple(
        {s: make_transform(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for s in g}
        for g in groups
    )
    pairs = [(a, b) for group in groups for a in group for b in group if a < b]
    shares = {pair: float(rng.random()) for pair in pairs}
    return Configuration(poses, shares, {pair: float(rng.random()) for pair in pairs[::-2]})


def with_merit(merit):
    return Configuration(all_alone(range(2)).poses, {(0, 1): merit}, {})


def name(configuration):
    return repr(configuration.shares).encode()


def test_what_is_packed_comes_back_to_the_last_bit_and_in_the_same_order():
    one = drawn(np.random.default_rng(3), [[7, 2, 300], [5], [40_000, 1, 0, 9]])
    again = Packed.of(one).unpacked()
    assert list(again.shares.items()) == list(one.shares.items())
    assert list(again.against.items()) == list(one.against.items())
    assert again.merit == one.merit == Packed.of(one).merit
    assert [list(poses) for poses in again.poses] == [list(poses) for poses in one.poses]
    for poses, expected in zip(again.poses, one.poses, strict=True):
        for scan, T in poses.items():
            np.testing.assert_array_equal(T, expected[scan])


def test_the_support_of_a_group_is_what_agrees_between_its_scans():
    one = drawn(np.random.default_rng(4), [[6, 2], [5, 1, 0, 9], [3]])
    assert [group.scans for group in one.groups] == [[0, 1, 5, 9], [2, 6], [3]]
    expected = [
        sum(share for pair, share in one.shares.items() if set(pair) <= set(group.scans))
        for group in one.groups
    ]
    assert [group.support for group in one.groups] == pytest.approx(expected)


def test_whatever_is_about_as_good_as_the_best_is_found_in_whatever_order_it_comes():
    merits = [3.0, 9.0, 7.5, 10.0, 7.9, 8.0, 8.5, 10.0]
    for order in (merits, merits[::-1], sorted(merits)):
        found = Found(name, Kept())
        for merit in order:
            found.add(with_merit(merit))
        assert [one.merit for one in found.ranked] == [10.0, 9.0, 8.5, 8.0]


def test_a_search_that_goes_on_keeps_what_is_known_and_the_first_of_each_name():
    known = Kept([Packed.of(with_merit(merit)) for merit in (5.0, 4.5)])
    found = Found(lambda one: str(int(one.merit)).encode(), known)
    for merit in (4.9, 5.9, 5.5, 6.0):
        found.add(with_merit(merit))
    assert [one.merit for one in found.ranked] == [6.0, 5.0]


def test_nothing_that_agrees_is_still_the_best_there_is():
    found = Found(name, Kept())
    for merit in (-2.0, -1.0, -1.5):
        found.add(with_merit(merit))
    assert found.ranked[0].merit == -1.0
