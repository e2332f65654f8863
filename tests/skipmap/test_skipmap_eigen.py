"""The closed-form eigensolver: against LAPACK, above all where two eigenvalues meet."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.skipmap.eigen import symmetric_eigh

COUNT = 5000
SPECTRA = {
    "any": lambda rng: np.sort(rng.uniform(size=(COUNT, 3))),
    "planes with equal sides": lambda rng: np.tile([1e-6, 1.0, 1.0], (COUNT, 1)),
    "planes with nearly equal sides": lambda rng: np.stack(
        [np.zeros(COUNT), np.ones(COUNT), 1 + rng.uniform(0, 1e-9, COUNT)], axis=1
    ),
    "lines": lambda rng: np.tile([1e-12, 1e-12, 1.0], (COUNT, 1)),
    "balls": lambda rng: np.ones((COUNT, 3)),
    "one place": lambda rng: np.zeros((COUNT, 3)),
    "tiny": lambda rng: 1e-200 * np.sort(rng.uniform(size=(COUNT, 3))),
    "huge": lambda rng: 1e200 * np.sort(rng.uniform(size=(COUNT, 3))),
}


def six_of(matrices):
    return matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


@pytest.fixture(params=SPECTRA)
def matrices(request):
    rng = np.random.default_rng(0)
    spectrum = SPECTRA[request.param](rng)
    axes = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
    matrices = axes @ (spectrum[:, :, None] * axes.transpose(0, 2, 1))
    return 0.5 * (matrices + matrices.transpose(0, 2, 1))


def test_eigenvalues_are_lapacks(matrices):
    values, _ = symmetric_eigh(six_of(matrices))
    largest = np.abs(matrices).max()
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrices), rtol=0, atol=1e-14 * largest)


def test_eigenvectors_are_orthonormal_and_solve_the_equation(matrices):
    values, vectors = symmetric_eigh(six_of(matrices))
    gram = vectors.transpose(0, 2, 1) @ vectors
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-14)
    largest = np.abs(matrices).max()
    residual = matrices @ vectors - vectors * values[:, None]
    assert np.abs(residual).max() <= 1e-14 * largest


def test_diagonal_matrices_have_their_entries_as_eigenvalues():
    entries = np.array([[1.0, 2, 3], [3, 1, 2], [2, 3, 1], [1, 1, 5], [5, 2, 2], [0, 0, 7]])
    six = np.zeros((len(entries), 6))
    six[:, [0, 3, 5]] = entries
    values, vectors = symmetric_eigh(six)
    np.testing.assert_allclose(values, np.sort(entries), atol=1e-15)
    np.testing.assert_allclose(np.abs(vectors[0]), np.eye(3), atol=1e-15)
