"""Hard pairs: what they share, and what they are."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import transform_points
from skipnet.metrics.poses import measured_overlap
from skipnet.simulation.scanning.hard import HARD_KINDS, hard_pair


@pytest.mark.parametrize("kind", [name for name in HARD_KINDS if "negative" not in name])
def test_scans_that_share_something_meet_under_the_true_motion(kind):
    pair = hard_pair(kind, 62_500)
    again = hard_pair(kind, 62_500)
    np.testing.assert_array_equal(pair.source_m, again.source_m)
    assert min(len(pair.source_m), len(pair.target_m)) > 2000
    extent_m = np.linalg.norm(np.ptp(pair.target_m, axis=0))
    assert measured_overlap(pair, 0.01 * extent_m) > 0.02
    moved_m = transform_points(pair.T_target_source, pair.source_m)
    assert np.isfinite(moved_m).all()


def test_narrow_views_share_little():
    assert measured_overlap(hard_pair("low_overlap", 62_501), 0.05) < 0.5


@pytest.mark.parametrize("kind", ["negative", "rings_negative"])
def test_unlike_pairs_are_of_two_scenes(kind):
    pair = hard_pair(kind, 62_502)
    assert pair.overlap == 0 and "," in pair.name


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="did you mean 'object'"):
        hard_pair("objects", 1)
