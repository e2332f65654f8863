"""The network in torch, and the losses that shape its descriptors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.nn.functional import normalize

from skipnet.features.cylinders import SECTOR_SIZE, SECTORS
from skipnet.features.patches import PATCH_SIZE
from skipnet.networks.numpy_network import (
    MEAN_GAIN,
    PLANE_GAIN,
    SHARED_LAYERS,
    SmallNetwork,
    cyclic_basis,
)
from skipnet.types import FeatureClass, FloatArray

MASKED = -1e4


@dataclass(frozen=True)
class Widths:
    """Units of the network's layers."""

    sector: int = 48
    """What a sector is summed up in."""
    hidden: int = 128
    output: int = 32
    """Numbers of a descriptor."""
    detail: int = 192
    """What the 125 cells about the voxel are summed up in, for the classes alone."""
    joint: int = 96
    """What the classes read of both."""


class Strongest(torch.autograd.Function):
    """``amax`` over the first axis, with its gradient; torch's own takes three times as long."""

    @staticmethod
    def forward(ctx: Any, responses: torch.Tensor) -> torch.Tensor:
        """(S, N, H) responses to the (N, H) strongest."""
        strongest = responses.amax(dim=0)
        ctx.save_for_backward(responses, strongest)
        return strongest

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> torch.Tensor:
        """The gradient goes to the strongest one; equal ones share it."""
        responses, strongest = ctx.saved_tensors
        shares = (responses == strongest).to(gradient.dtype)
        return shares * (gradient / shares.sum(dim=0))


class DescriptorNetwork(nn.Module):
    """The network of ``networks.numpy_network.SmallNetwork`` in torch, while all of it learns.

    What reads the classes here lets them shape the hidden units; the class head that is kept learns
    from these when they have settled (``class_head``).

    Args:
        widths: units of its layers.
        dropout: share of the class head's hidden units that training leaves out at random.
    """

    input_mean: torch.Tensor
    input_gain: torch.Tensor
    detail_mean: torch.Tensor
    detail_gain: torch.Tensor
    basis: torch.Tensor

    def __init__(self, widths: Widths, dropout: float = 0.0) -> None:
        super().__init__()
        self.sector = nn.Linear(SECTOR_SIZE, widths.sector)
        self.mixing = nn.Linear(SECTORS * widths.sector, widths.hidden)
        self.output = nn.Linear(widths.hidden, widths.output)
        self.matchable = nn.Linear(widths.hidden, 1)
        self.detail = nn.Linear(PATCH_SIZE, widths.detail)
        self.joint = nn.Linear(widths.detail + widths.hidden, widths.joint)
        self.classes = nn.Linear(widths.joint, len(FeatureClass))
        self.dropout = nn.Dropout(dropout)
        for name, size in (("input", SECTOR_SIZE), ("detail", PATCH_SIZE)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_gain", torch.ones(size))
        self.register_buffer("basis", torch.from_numpy(cyclic_basis()), persistent=False)

    def fit_scaling(self, patches: torch.Tensor, details: torch.Tensor) -> None:
        """Bring each input to mean 0 and deviation 1.

        Args:
            patches: (N, 5, 100), over which and over all sectors this shall hold.
            details: (M, 125), of the same or other voxels.
        """
        self.input_mean.copy_(patches.mean(dim=(0, 1)))
        self.input_gain.copy_(1 / (patches.std(dim=(0, 1)) + 1e-2))
        self.detail_mean.copy_(details.mean(dim=0))
        self.detail_gain.copy_(1 / (details.std(dim=0) + 1e-2))

    def forward(self, patches: torch.Tensor) -> torch.Tensor:
        """(N, 5, 100) patches to the (N, H) hidden units that all heads read."""
        scaled = ((patches - self.input_mean) * self.input_gain).transpose(0, 1)
        sums = torch.relu(self.sector(scaled))
        waves = (self.basis @ sums.flatten(1)).view_as(sums)
        mixing = self.mixing.weight.unflatten(1, (SECTORS, -1)).permute(1, 2, 0)
        mixing = (self.basis @ mixing.flatten(1)).view_as(mixing)
        responses = [waves[0] @ mixing[0] * float(MEAN_GAIN)]
        for k in (1, 3):
            both = torch.cat([waves[k], waves[k + 1]], dim=1) * float(PLANE_GAIN)
            responses.append(both @ torch.cat([mixing[k], mixing[k + 1]]))
            responses.append(both @ torch.cat([mixing[k + 1], -mixing[k]]))
        orders = (self.basis.T @ torch.stack(responses).flatten(1)).view(SECTORS, len(patches), -1)
        return torch.relu(Strongest.apply(orders) + self.mixing.bias)

    def recognise(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, H) hidden units to (N, D) descriptors of length 1 and (N,) logits of matchability.

        The matchability takes the hidden units as they are: learning it does not change them.
        """
        return normalize(self.output(hidden), dim=1), self.matchable(hidden.detach())[:, 0]

    def classify(self, details: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
        """(N, 125) details and (N, H) hidden units to (N, 5) logits of the classes."""
        scaled = (details - self.detail_mean) * self.detail_gain
        both = torch.cat([self.dropout(torch.relu(self.detail(scaled))), hidden], dim=1)
        return self.classes(self.dropout(torch.relu(self.joint(both))))

    def arrays(self) -> dict[str, FloatArray]:
        """The shared layers as ``SmallNetwork`` takes them."""
        arrays: dict[str, FloatArray] = {}
        for name in SHARED_LAYERS:
            arrays |= layer_arrays(name, getattr(self, name))
        return arrays | layer_arrays("sector", self.sector, self.input_mean, self.input_gain)

    def model(self) -> SmallNetwork:
        """The shared layers as they are used, with the weights that they have now."""
        return SmallNetwork(self.arrays(), {})


def layer_arrays(
    name: str,
    layer: nn.Linear,
    offset: torch.Tensor | None = None,
    gain: torch.Tensor | None = None,
) -> dict[str, FloatArray]:
    """Weight and bias of a layer as ``SmallNetwork`` takes them.

    Args:
        name: of the layer.
        layer: in torch.
        offset: of its inputs, (I,): their scaling by offset and gain is folded in; None for none.
        gain: (I,), applied after the offset was taken off.
    """
    weight = layer.weight.detach().cpu().numpy().T.copy()
    bias = layer.bias.detach().cpu().numpy().copy()
    if offset is not None and gain is not None:
        weight *= gain.cpu().numpy()[:, None]
        bias -= offset.cpu().numpy() @ weight
    return {f"{name}_weight": weight, f"{name}_bias": bias}
