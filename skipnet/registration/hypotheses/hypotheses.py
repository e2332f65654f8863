"""What every generator returns: candidate poses with weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.clouds.statistics import largest
from skipnet.types import FloatArray


@dataclass(frozen=True)
class Hypotheses:
    """Candidate poses."""

    T_target_source: FloatArray
    """(C, 4, 4) float64."""
    weights: FloatArray
    """(C,) how much speaks for each, comparable within one generator only."""

    def __len__(self) -> int:
        return len(self.weights)

    def best(self, count: int) -> Hypotheses:
        """The ``count`` heaviest."""
        keep = largest(self.weights, count)
        return Hypotheses(self.T_target_source[keep], self.weights[keep])


NO_HYPOTHESES = Hypotheses(np.zeros((0, 4, 4)), np.zeros(0))


def concatenate(stacks: list[Hypotheses]) -> Hypotheses:
    """All candidates of several generators, in order."""
    if not stacks:
        return NO_HYPOTHESES
    return Hypotheses(
        np.concatenate([stack.T_target_source for stack in stacks]),
        np.concatenate([stack.weights for stack in stacks]),
    )
