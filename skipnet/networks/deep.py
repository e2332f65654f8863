"""The deep network in torch: convolutions over cylindrical grids, circular around the axis.

Local patterns first, with the same weights at every height, radius, sector and scale; then all
heights, radii and scales of a sector together; then sectors with their neighbours; of what these
say the strongest counts, so that a turn about the axis changes little.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn.functional import normalize, pad

from skipnet.features.grids import CHANNELS, HEIGHTS, RADII, SCALES, SECTORS

_STEP = 2
"""Cells that are joined along each axis by the first layer."""


class LocalBlock(nn.Module):
    """Adds to (N, H, R, A, C) what the neighbourhood of each cell says: around, then across."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels)
        self.around = nn.Linear(3 * channels, channels)
        self.across = nn.Linear(9 * channels, channels)

    def forward(self, cells: torch.Tensor) -> torch.Tensor:
        """(N, H, R, A, C) to the same."""
        inner = torch.relu(self.around(_neighbouring_sectors(self.norm(cells))))
        height, radius = inner.shape[1:3]
        wide = pad(inner, (0, 0, 0, 0, 1, 1, 1, 1))
        shifted = [wide[:, i : i + height, j : j + radius] for i in range(3) for j in range(3)]
        return cells + self.across(torch.cat(shifted, dim=-1))


def _neighbouring_sectors(cells: torch.Tensor) -> torch.Tensor:
    """(..., A, C) to (..., A, 3 C): each sector with the ones before and behind it."""
    return torch.cat([cells.roll(1, dims=-2), cells, cells.roll(-1, dims=-2)], dim=-1)


class DeepNetwork(nn.Module):
    """(N, 2, 8, 6, 16, 7) grids to descriptors; what ``train.py network=deep`` trains.

    Args:
        local: channels of the local patterns.
        hidden: units of a sector, and of the whole.
        output: numbers of a descriptor.
        blocks: local blocks, one after the other.
    """

    input_mean: torch.Tensor
    input_gain: torch.Tensor

    def __init__(
        self, local: int = 32, hidden: int = 192, output: int = 48, blocks: int = 2
    ) -> None:
        super().__init__()
        self.widths = {"local": local, "hidden": hidden, "output": output, "blocks": blocks}
        cells = HEIGHTS // _STEP * (RADII // _STEP)
        self.joining = nn.Linear(_STEP * _STEP * 2 * _STEP * CHANNELS, local)
        self.blocks = nn.Sequential(*[LocalBlock(local) for _ in range(blocks)])
        self.norm = nn.LayerNorm(local)
        self.sector = nn.Linear(SCALES * cells * local, hidden)
        self.around = nn.Linear(3 * hidden, hidden)
        self.output = nn.Linear(hidden, output)
        self.matchable = nn.Linear(hidden, 1)
        self.register_buffer("input_mean", torch.zeros(SCALES, CHANNELS))
        self.register_buffer("input_gain", torch.ones(SCALES, CHANNELS))

    def fit_scaling(self, grids: torch.Tensor) -> None:
        """Bring each channel of each scale to mean 0 and deviation 1 over (N, ...) grids."""
        self.input_mean.copy_(grids.mean(dim=(0, 2, 3, 4)))
        self.input_gain.copy_(1 / (grids.std(dim=(0, 2, 3, 4)) + 1e-3))

    def forward(self, grids: torch.Tensor) -> torch.Tensor:
        """(N, 2, 8, 6, 16, 7) grids to (N, hidden) units."""
        count = len(grids)
        mean, gain = (values[:, None, None, None] for values in (self.input_mean, self.input_gain))
        scaled = ((grids - mean) * gain).flatten(0, 1)
        cells = self.blocks(torch.relu(self.joining(_join(scaled))))
        cells = torch.relu(self.norm(cells))
        # (N, S, H, R, A, C) to (N, A, S H R C): all of a sector together.
        sectors = cells.unflatten(0, (count, SCALES)).permute(0, 4, 1, 2, 3, 5).flatten(2)
        units = torch.relu(self.sector(sectors))
        return torch.relu(self.around(_neighbouring_sectors(units)).amax(dim=1))

    def recognise(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(N, H) hidden units to (N, D) descriptors of length 1 and (N,) matchability logits.

        The matchability takes the hidden units as they are: learning it does not change them.
        """
        return normalize(self.output(hidden), dim=1), self.matchable(hidden.detach())[:, 0]


def _join(grids: torch.Tensor) -> torch.Tensor:
    """(N, 8, 6, 16, 7) cells to (N, 4, 3, 8, 112): 2 x 2 x 4 together, sectors overlapping."""
    tiles = grids.unflatten(1, (-1, _STEP)).unflatten(3, (-1, _STEP))  # N, 4, 2, 3, 2, 16, 7
    first = torch.arange(0, SECTORS, _STEP, device=grids.device)
    sectors = (first[:, None] + torch.arange(-1, 2 * _STEP - 1, device=grids.device)) % SECTORS
    tiles = tiles[:, :, :, :, :, sectors]  # N, 4, 2, 3, 2, 8, 4, 7
    return tiles.permute(0, 1, 3, 5, 2, 4, 6, 7).flatten(4)
