"""When a pose that scores less is as good an explanation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from skipnet.registration import examining
from skipnet.registration.alignment.refinement import Refinement, no_refinement
from skipnet.registration.examining import compare_rivals
from skipnet.registration.judging.score import Score


def rivals(contradicted, lead, clear, are_narrow, held_voxels=100.0):
    """How many poses rival one that leads them by so much, and is told from them so clearly."""
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, :3] = np.diag([-1.0, -1.0, 1.0])  # turned by half: no repeat of the first
    total = np.array([1.0, 1.0 - lead])
    violation = np.full(2, contradicted)
    score = Score(total, total, violation, total, violation, np.zeros(2))
    judge = SimpleNamespace(blind=1.0, decisiveness=lambda best, others: np.array([clear]))
    information = np.repeat(np.diag([held_voxels, 300, 300, 300, 300, 300])[None], 2, axis=0)
    matched, spread_m = np.full(2, 900), np.ones(2)
    fine = Refinement(T, information, matched, np.zeros((2, 3)), spread_m)
    found = compare_rivals(judge, fine, T, score, np.arange(2), are_narrow)
    return len(found.alternatives)


@pytest.mark.parametrize(
    ("contradicted", "lead", "clear", "wide", "narrow"),
    [
        (0.001, 0.6, 0.3, 0, 1),
        (0.001, 0.75, 0.3, 0, 0),  # it leads by more
        (0.001, 0.6, 0.5, 0, 0),  # it differs more clearly
        (0.0, 0.6, 0.3, 0, 0),  # nothing contradicts it
        (0.001, 0.3, 0.1, 1, 1),
    ],
)
def test_a_contradicted_narrow_view_must_lead_by_more(contradicted, lead, clear, wide, narrow):
    assert rivals(contradicted, lead, clear, are_narrow=False) == wide
    assert rivals(contradicted, lead, clear, are_narrow=True) == narrow
    # What lies on itself and is hardly held must lead as narrow views must.
    assert rivals(contradicted, lead, clear, False, held_voxels=5.0) == narrow


def test_what_is_an_alternative_anyway_is_not_asked_whether_it_slips(monkeypatch):
    T = np.tile(np.eye(4), (4, 1, 1))
    total = np.array([1.0, 0.99, 0.9, 0.9])  # one that explains as much, two that may be repeats
    nothing = np.zeros(4)
    score = Score(total, total, nothing, total, nothing, nothing)
    judge = SimpleNamespace(blind=0.0, decisiveness=lambda best, others: np.zeros(len(others)))
    asked = []
    monkeypatch.setattr(examining, "_slips", lambda judge, fine, T, row: asked.append(row) or False)
    fine, kept = no_refinement(T), np.arange(4)
    assert len(compare_rivals(judge, fine, T, score, kept).alternatives) == 3
    assert asked == [2, 3]
    asked.clear()
    assert len(compare_rivals(judge, fine, T, score, kept, one_will_do=True).alternatives) > 0
    assert asked == []
    score = score.replaced(np.array([1]), score[np.array([2])])
    assert len(compare_rivals(judge, fine, T, score, kept, one_will_do=True).alternatives) > 0
    assert asked == [1]
