"""What a training learns from, and the loss of the paper."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import cross_entropy

from skipnet.types import FloatArray, IntArray

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""(N, 125) patches, (N,) labels, (N,) weights of mean 1."""


@dataclass(frozen=True)
class TrainingSet:
    """What a network is fitted to, or watched on."""

    patches: FloatArray
    """(N, 125)."""
    labels: IntArray
    """(N,) classes."""
    weights: FloatArray | None = None
    """(N,) how much each sample's loss counts; only ratios matter. None counts all alike."""

    def digest(self) -> str:
        """Hash of it."""
        sha = hashlib.sha256()
        for values in (self.patches, self.labels, self.weights):
            sha.update(b"none" if values is None else np.ascontiguousarray(values).tobytes())
        return sha.hexdigest()[:16]

    def tensors(self, dtype: torch.dtype) -> Batch:
        """Patches, labels and weights of mean 1.

        Raises:
            ValueError: no samples, or not one label for each.
        """
        count = len(self.labels)
        if count == 0 or len(self.patches) != count:
            raise ValueError(
                f"need one label per patch, got {count} labels for {len(self.patches)} patches"
            )
        weights = np.ones(count) if self.weights is None else self.weights / self.weights.mean()
        return (
            torch.as_tensor(self.patches, dtype=dtype),
            torch.as_tensor(self.labels, dtype=torch.int64),
            torch.as_tensor(weights, dtype=dtype),
        )


def matlab_cross_entropy(
    logits: torch.Tensor, labels: torch.Tensor, weights: torch.Tensor | None = None
) -> torch.Tensor:
    """MATLAB's ``crossentropy``: the mean over outputs x samples, a fifth of PyTorch's for five.

    ``weights`` (N,) multiply each sample's loss; leave them out for weights of 1.
    """
    loss = cross_entropy(logits, labels, reduction="none")
    return (loss if weights is None else loss * weights).mean() / logits.shape[1]
