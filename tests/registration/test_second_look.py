"""A second look: small things on a large plane, for which its voxels are rough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skipnet.registration import pipeline
from skipnet.registration.pipeline import register
from skipnet.registration.second_look import MIN_SURE, is_sure
from skipnet.simulation.situations.making import between, block, camera, caster_of, see
from skipnet.types import Status

TABLE = block((4, 4, 0.03), (0, 0, -0.015))
THING = block((0.1, 0.02, 0.16), (0, 0, 0.08), 0.3) + block((0.02, 0.08, 0.05), (0.03, 0.04, 0.025))
THING += block((0.05, 0.09, 0.05), (-0.05, 0.06, 0.025), 0.7)


def two_views(apart_deg):
    """Two camera views of a few small blocks on a table, and the pose."""
    rng, clouds_m, poses = np.random.default_rng(0), [], []
    for angle in np.deg2rad([20.0, 20.0 + apart_deg]):
        eye_m = np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.5])
        T, ways = camera(eye_m, (0, 0, 0.05), 55.0, 300, 220)
        clouds_m.append(see(caster_of(TABLE + THING), T, ways, 0.001, rng, 3.0))
        poses.append(T)
    return *clouds_m, between(*poses)


@pytest.fixture(scope="module")
def looks():
    source_m, target_m, T = two_views(25.0)
    return source_m, target_m, T, register(source_m, target_m)


def test_a_small_thing_fixes_the_pose_in_finer_voxels(looks, monkeypatch):
    source_m, target_m, T, result = looks
    assert result.status is Status.REGISTERED, result.reason
    assert np.linalg.norm((result.T_target_source - T)[:3, 3]) < 0.02
    monkeypatch.setattr(pipeline, "is_worth_it", lambda *_: False)
    before = register(source_m, target_m)
    assert before.status is Status.AMBIGUOUS and "nothing fixes" in before.reason
    assert before.voxel_size_m == pytest.approx(2 * result.voxel_size_m)


def test_a_voxel_size_that_is_given_is_kept(looks):
    source_m, target_m, _, result = looks
    given_m = 2 * result.voxel_size_m
    assert register(source_m, target_m, voxel_size_m=given_m).voxel_size_m == given_m


def test_only_a_sure_and_clean_second_look_counts(looks):
    result = looks[-1]
    assert is_sure(result)
    assert not is_sure(replace(result, confidence=MIN_SURE - 0.01))
    assert not is_sure(replace(result, status=Status.AMBIGUOUS))
    contradicted = replace(result.findings, contradiction=0.01)
    assert not is_sure(replace(result, findings=contradicted))
