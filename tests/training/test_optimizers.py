"""Optimisers against functions whose minimum is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from skipnet.training.optimizers import ScaledConjugateGradient


def minimise(function, start: Tensor, steps: int, **options) -> tuple[Tensor, list[float]]:
    point = start.clone().requires_grad_(True)
    optimizer = ScaledConjugateGradient([point], **options)

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = function(point)
        loss.backward()
        return loss

    losses = [float(optimizer.step(closure)) for _ in range(steps)]
    return point.detach(), losses


def rosenbrock(point: Tensor) -> Tensor:
    return (1 - point[0]) ** 2 + 100 * (point[1] - point[0] ** 2) ** 2


@pytest.mark.parametrize("size", [2, 5, 10])
def test_quadratic_is_solved_in_as_many_steps_as_it_has_dimensions(size: int) -> None:
    rng = np.random.default_rng(size)
    basis = np.linalg.qr(rng.normal(size=(size, size)))[0]
    matrix = basis @ np.diag(np.linspace(1.0, 9.0, size)) @ basis.T
    right = rng.normal(size=size)
    A, b = torch.tensor(matrix), torch.tensor(right)

    found, _ = minimise(lambda x: 0.5 * x @ A @ x - b @ x, torch.zeros(size).double(), size)

    np.testing.assert_allclose(found.numpy(), np.linalg.solve(matrix, right), atol=2e-5)


def test_rosenbrock_reaches_its_minimum() -> None:
    start = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    found, losses = minimise(rosenbrock, start, 300)
    np.testing.assert_allclose(found.numpy(), [1.0, 1.0], atol=1e-4)
    assert losses[-1] < 1e-9


def test_least_squares_agrees_with_numpy() -> None:
    rng = np.random.default_rng(0)
    design, values = rng.normal(size=(40, 6)), rng.normal(size=40)
    D, v = torch.tensor(design), torch.tensor(values)
    found, _ = minimise(lambda x: ((D @ x - v) ** 2).mean(), torch.zeros(6).double(), 30)
    expected = np.linalg.lstsq(design, values, rcond=None)[0]
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-7)


def test_loss_never_rises_and_negative_curvature_is_survived() -> None:
    # A double well seen from its ridge: the Hessian is negative at the start.
    def wells(x: Tensor) -> Tensor:
        return (x**4 - 2 * x**2).sum()

    found, losses = minimise(wells, torch.tensor([0.1, -0.3], dtype=torch.float64), 60)
    assert all(later <= earlier for earlier, later in zip(losses, losses[1:], strict=False))
    np.testing.assert_allclose(found.abs().numpy(), [1.0, 1.0], atol=1e-5)


def test_a_step_outside_the_domain_is_refused() -> None:
    # log is NaN beyond 0; a step there must be taken back, not kept.
    def barrier(x: Tensor) -> Tensor:
        return (x - torch.log(x)).sum()

    found, losses = minimise(barrier, torch.tensor([0.01], dtype=torch.float64), 200)
    assert np.isfinite(losses).all()
    np.testing.assert_allclose(found.numpy(), [1.0], atol=1e-5)


def test_a_minimum_at_the_start_is_left_alone() -> None:
    found, losses = minimise(lambda x: (x**2).sum(), torch.zeros(3).double(), 3)
    assert losses == [0.0, 0.0, 0.0]
    assert torch.equal(found, torch.zeros(3).double())


def test_gradient_norm_is_the_one_at_the_current_point() -> None:
    point = torch.tensor([3.0, 4.0], dtype=torch.float64, requires_grad=True)
    optimizer = ScaledConjugateGradient([point])
    assert optimizer.gradient_norm() == float("inf")

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = (point**4).sum()
        loss.backward()
        return loss

    optimizer.step(closure)
    expected = float((4 * point.detach() ** 3).norm())
    assert optimizer.gradient_norm() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("parameters", "options", "message"),
    [
        ([torch.zeros(2)], {}, "float64"),
        ([torch.zeros(2).double()], {"sigma": 0.0}, "positive"),
        ([torch.zeros(2).double()], {"lambda_": -1.0}, "positive"),
    ],
)
def test_bad_input_says_what_is_wrong(parameters, options, message) -> None:
    with pytest.raises(ValueError, match=message):
        ScaledConjugateGradient(parameters, **options)


def test_a_step_without_closure_is_refused() -> None:
    with pytest.raises(ValueError, match="closure"):
        ScaledConjugateGradient([torch.zeros(2).double()]).step()
