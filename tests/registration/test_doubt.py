"""How much larger than the surfaces' scatter predicts a covariance is stated."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from skipnet.registration.aligners import DenseAligner, SparseAligner


def scan(step_m, voxel_size_m=0.1):
    return SimpleNamespace(
        lattice_step_m=step_m, fine_skipmap=SimpleNamespace(voxel_size_m=voxel_size_m)
    )


def doubt(aligner, source_step_m, target_step_m, held_voxels):
    one = aligner(scan(source_step_m), scan(target_step_m), judge=None, samples=0)
    return one.doubt(held_voxels)


def test_what_many_voxels_hold_is_stated_as_the_scatter_predicts():
    assert doubt(DenseAligner, 0.0, 0.0, 1e6) == pytest.approx(1.0, abs=1e-4)


def test_few_voxels_steps_and_scan_lines_are_doubted():
    assert doubt(DenseAligner, 0.0, 0.0, 20.0) == pytest.approx(2.0)
    assert doubt(DenseAligner, 0.0, 0.0, 0.0) == doubt(DenseAligner, 0.0, 0.0, 1.0)
    fine, rough = (doubt(DenseAligner, 0.0, step_m, 1e6) for step_m in (0.001, 0.05))
    assert fine < 1.001 < 10 < rough
    assert rough == doubt(DenseAligner, 0.05, 0.0, 1e6)
    assert doubt(SparseAligner, 0.0, 0.0, 50.0) == 2.5
