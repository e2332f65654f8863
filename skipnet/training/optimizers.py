"""Optimisers by name; Moller's scaled conjugate gradient as a ``torch.optim.Optimizer``.

MATLAB's ``trainscg``, which the paper used, has no counterpart in PyTorch; this one fills the gap.
It is stepped with a closure, as any optimiser may be, so the training loop need not know which
optimiser it holds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import torch

Closure = Callable[[], torch.Tensor]
OptimizerFactory = Callable[..., torch.optim.Optimizer]
"""Called with the parameters to optimise."""
_HOMES = {"torch.optim": torch.optim, __name__: sys.modules[__name__]}
"""Where optimisers are looked for."""
_EXPECTED = " or ".join(f"{home}.NAME" for home in _HOMES)


def find_optimizer(options: Mapping[str, Any]) -> OptimizerFactory:
    """The optimiser that ``_target_`` names, with the other options as its arguments.

    Nothing else can be named there: a configuration may come from anywhere.

    Raises:
        ValueError: it is none of ``torch.optim`` or of this module, has no such argument, or cannot
            take such a value.
    """
    target = str(options.get("_target_"))
    home, _, name = target.rpartition(".")
    found = vars(_HOMES[home]).get(name) if home in _HOMES else None
    if not (isinstance(found, type) and issubclass(found, torch.optim.Optimizer)):
        raise ValueError(f"optimizer._target_={target}: expected an optimiser of {_EXPECTED}")
    arguments = {k: v for k, v in options.items() if k not in ("_target_", "_partial_")}
    make: OptimizerFactory = partial(found, **arguments)
    try:
        make([torch.nn.Parameter(torch.zeros(1, dtype=torch.float64))])
    except (TypeError, ValueError) as error:
        raise ValueError(f"optimizer={dict(options)}: {error}") from error
    return make


class ScaledConjugateGradient(torch.optim.Optimizer):
    """Scaled conjugate gradient for a full-batch, deterministic loss.

    One ``step`` is one iteration k of M. F. Moller, "A scaled conjugate gradient algorithm for fast
    supervised learning", Neural Networks 6 (1993) 525-533, section 4. There is no line search: the
    curvature along the direction comes from one difference of gradients, and a scale ``lambda``
    keeps it positive, as in Levenberg-Marquardt. An iteration costs two evaluations of the closure,
    or one after an iteration that was refused.

    Args:
        params: parameters to optimise, one group. Use float64: a difference over ``sigma`` has lost
            about nine digits when it is formed.
        sigma: step of the gradient difference, relative to the direction's length (trainscg: 5e-5).
        lambda_: first scale of the curvature (trainscg: 5e-7).

    Raises:
        ValueError: parameters that are not float64, or scales that are not positive.
    """

    def __init__(
        self, params: Iterable[torch.Tensor], sigma: float = 5e-5, lambda_: float = 5e-7
    ) -> None:
        if not (sigma > 0 and lambda_ > 0):
            raise ValueError(f"sigma and lambda_ must be positive, got {sigma} and {lambda_}")
        super().__init__(params, {"sigma": sigma, "lambda_": lambda_})
        if len(self.param_groups) != 1:
            raise ValueError("scaled conjugate gradient takes one parameter group; merge them")
        self._parameters: list[torch.Tensor] = self.param_groups[0]["params"]
        if any(parameter.dtype != torch.float64 for parameter in self._parameters):
            raise ValueError("scaled conjugate gradient needs float64; call model.double() first")

    @torch.no_grad()
    def step(self, closure: Closure | None = None) -> torch.Tensor:  # type: ignore[override]
        """Run one iteration and return the loss where the parameters are now.

        Args:
            closure: clears the gradients, computes the loss, calls ``backward``, returns the loss.
                It must compute the same function at every step.

        Raises:
            ValueError: no closure.
        """
        if closure is None:
            raise ValueError("scaled conjugate gradient needs a closure: optimizer.step(closure)")
        evaluate = torch.enable_grad()(closure)
        state = self.state[self._parameters[0]] or self._start(evaluate)
        if state["descent"].norm() == 0:  # an exact minimum: Moller's step 9
            return state["loss"]
        weights, direction = self._weights(), state["direction"]
        length2 = direction.dot(direction)
        if state["accepted"]:
            state["curvature"] = self._curvature(evaluate, weights, direction, state["descent"])
        curvature = self._make_positive(state, length2)
        slope = direction.dot(state["descent"])
        step_size = slope / curvature
        loss, gradient = self._evaluate(evaluate, weights + step_size * direction)
        # How well the quadratic model foresaw the loss: 1 exactly, below 0 the loss has risen.
        comparison = 2 * curvature * (state["loss"] - loss) / slope**2
        if comparison >= 0:
            self._accept(state, loss, -gradient, slope, comparison)
        else:
            self._refuse(state, weights)
        if not comparison >= 0.25:
            shortfall = 1 - comparison if torch.isfinite(comparison) else 4.0
            state["lambda"] = state["lambda"] + curvature * shortfall / length2
        return state["loss"]

    def gradient_norm(self) -> float:
        """Length of the gradient where the parameters are now; infinity before the first step."""
        state = self.state[self._parameters[0]]
        return float(state["descent"].norm()) if state else float("inf")

    def _start(self, evaluate: Closure) -> dict[str, Any]:
        loss, gradient = self._evaluate(evaluate, self._weights())
        state = self.state[self._parameters[0]]
        state.update(loss=loss, descent=-gradient, direction=-gradient, iteration=0, accepted=True)
        state.update({"lambda": torch.full_like(loss, self.param_groups[0]["lambda_"])})
        state["lambda_bar"] = torch.zeros_like(loss)
        return state

    def _curvature(
        self,
        evaluate: Closure,
        weights: torch.Tensor,
        direction: torch.Tensor,
        descent: torch.Tensor,
    ) -> torch.Tensor:
        """Second directional derivative by one difference of gradients (step 2)."""
        offset = self.param_groups[0]["sigma"] / direction.norm()
        _, gradient = self._evaluate(evaluate, weights + offset * direction)
        return direction.dot(gradient + descent) / offset

    @staticmethod
    def _make_positive(state: dict[str, Any], length2: torch.Tensor) -> torch.Tensor:
        """Scale the curvature, and raise ``lambda`` until it is positive (steps 3 and 4)."""
        curvature = state["curvature"] + (state["lambda"] - state["lambda_bar"]) * length2
        if curvature <= 0:
            state["lambda_bar"] = 2 * (state["lambda"] - curvature / length2)
            curvature = -curvature + state["lambda"] * length2
            state["lambda"] = state["lambda_bar"]
        state["curvature"] = curvature
        return curvature

    def _accept(
        self,
        state: dict[str, Any],
        loss: torch.Tensor,
        descent: torch.Tensor,
        slope: torch.Tensor,
        comparison: torch.Tensor,
    ) -> None:
        """Keep the new weights and choose the next conjugate direction (step 7)."""
        state["iteration"] += 1
        if state["iteration"] % descent.numel() == 0:
            direction = descent.clone()
        else:
            beta = (descent.dot(descent) - descent.dot(state["descent"])) / slope
            direction = descent + beta * state["direction"]
            if direction.dot(descent) <= 0:  # rounding has spoilt conjugacy: start again
                direction = descent.clone()
        state.update(loss=loss, descent=descent, direction=direction, accepted=True)
        state["lambda_bar"] = torch.zeros_like(loss)
        if comparison >= 0.75:
            state["lambda"] = state["lambda"] / 4

    def _refuse(self, state: dict[str, Any], weights: torch.Tensor) -> None:
        torch.nn.utils.vector_to_parameters(weights, self._parameters)
        state["lambda_bar"] = state["lambda"].clone()
        state["accepted"] = False

    def _weights(self) -> torch.Tensor:
        return torch.nn.utils.parameters_to_vector(self._parameters).clone()

    def _evaluate(
        self, evaluate: Closure, weights: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Move the parameters to ``weights``; return the loss and the flat gradient there."""
        torch.nn.utils.vector_to_parameters(weights, self._parameters)
        loss = evaluate().detach().clone()
        parts = [torch.zeros_like(p) if p.grad is None else p.grad for p in self._parameters]
        return loss, torch.cat([part.reshape(-1) for part in parts])
