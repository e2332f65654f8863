"""From candidates to an answer: which of several poses comes first."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.findings import Findings
from skipnet.registration.judging.score import Score
from skipnet.registration.settling import firmest_first
from skipnet.registration.verdict import decide


def alignment_of(held_shares):
    """Poses whose matches hold the translation along x by these shares, all else firmly."""
    count = len(held_shares)
    information = np.repeat(np.eye(6)[None], count, axis=0)
    information[:, 3, 3] = held_shares
    return Refinement(
        np.repeat(np.eye(4)[None], count, axis=0),
        information,
        np.full(count, 1000),
        np.zeros((count, 3)),
        np.ones(count),
    )


@pytest.mark.parametrize(
    ("total", "first"),
    [
        ((0.50, 0.48, 0.20), 1),  # about as good, and firmly held
        ((0.50, 0.40, 0.20), 0),  # a clear lead counts for more than any hold
        ((0.20, 0.48, 0.50), 2),  # the firm one is best already
    ],
)
def test_of_equally_good_poses_the_firmest_held_one_comes_first(total, first):
    total = np.array(total)
    kept = np.argsort(-total)
    order = firmest_first(kept, Score(total, total, 0 * total), alignment_of([1e-4, 0.3, 0.5]))
    assert order[0] == first
    assert sorted(order) == sorted(kept)
    assert list(order[1:]) == [row for row in kept if row != first]


@pytest.mark.parametrize(("held_voxels", "status"), [(0.05, "ambiguous"), (50.0, "registered")])
def test_a_pose_that_next_to_nothing_holds_is_not_registered(held_voxels, status):
    findings = Findings(
        overlap=0.85,
        violation=0.0,
        margin=0.9,
        matched=10_000,
        held_voxels=held_voxels,
        blind=0.0,
        covariance=np.eye(6),
        free_directions=np.zeros((0, 3)),
        free_turns=np.zeros((0, 3)),
        alternatives=np.zeros((0, 4, 4)),
    )
    verdict = decide(findings)
    assert verdict.status == status
    assert (verdict.confidence <= 0.5) == (status == "ambiguous")
