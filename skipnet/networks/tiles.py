"""Tiles of cylindrical grids: of 2 x 2 x 4 cells, most are empty, and all empty ones say the same.

So what the deep network computes of a tile by itself it computes of those that hold something; what
the others add to it is that of an empty grid.
"""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.features.grids import CHANNELS, HEIGHTS, RADII, SCALES, SECTORS
from skipnet.types import BoolArray, FloatArray, IntArray

TILES = (SCALES, HEIGHTS // 2, RADII // 2, SECTORS // 2)
"""Scales, heights, radii and sectors of a grid's tiles; those of neighbouring sectors overlap."""
TILE_SIZE = 16 * CHANNELS
"""Numbers in one tile."""


def list_tiles(grids: FloatArray) -> tuple[IntArray, IntArray]:
    """(M, 5) int32 grid, scale, height, radius and sector of tiles that are not empty, and of those
    with a neighbouring sector that is not, (R, 5) likewise; of (N, 2, 8, 6, 16, 7) grids."""
    held = np.zeros((len(grids), *TILES), np.bool_)
    _mark(grids, held)
    near = held | np.roll(held, 1, -1) | np.roll(held, -1, -1)
    return np.argwhere(held).astype(np.int32), np.argwhere(near).astype(np.int32)


@compiled
def _mark(grids: FloatArray, held: BoolArray) -> None:
    """Mark the tiles with a cell that counts something: where none does, all is 0."""
    for n in range(len(grids)):
        for s in range(held.shape[1]):
            for i in range(grids.shape[2]):
                for j in range(grids.shape[3]):
                    tiles = held[n, s, i // 2, j // 2]
                    for a in range(grids.shape[4]):
                        if grids[n, s, i, j, a, 0] != 0:
                            own = a // 2
                            tiles[own] = True
                            beside = own + 2 * (a % 2) - 1  # tiles reach a sector far to each side
                            tiles[beside % len(tiles)] = True


@compiled
def cut_tiles(
    grids: FloatArray, mean: FloatArray, gain: FloatArray, where: IntArray, tiles: FloatArray
) -> None:
    """Scale and copy tiles.

    Args:
        grids: (N, 2, 8, 6, 16, 7).
        mean: (2, 7) of each scale's channels, to be taken off ...
        gain: ... before what is left is multiplied by this.
        where: (M, 5) of ``list_tiles``.
        tiles: (M, 112) to fill: heights, radii, sectors, channels.
    """
    sectors, channels = grids.shape[4], grids.shape[5]
    for m in range(len(where)):
        n, s, first = where[m, 0], where[m, 1], 2 * where[m, 4] - 1
        at = 0
        for i in range(2 * where[m, 2], 2 * where[m, 2] + 2):
            for j in range(2 * where[m, 3], 2 * where[m, 3] + 2):
                for a in range(first, first + 4):
                    cell = grids[n, s, i, j, a % sectors]
                    for c in range(channels):
                        tiles[m, at + c] = (cell[c] - mean[s, c]) * gain[s, c]
                    at += channels


@compiled
def join_sectors(cells: FloatArray, where: IntArray, joined: FloatArray) -> None:
    """Tiles at (R, 5) places with the ones before and behind them, of (N, 2, 4, 3, 8, C) into
    (R, 3 C)."""
    sectors, width = cells.shape[4], cells.shape[5]
    for r in range(len(where)):
        ring = cells[where[r, 0], where[r, 1], where[r, 2], where[r, 3]]
        for part in range(3):
            own = ring[(where[r, 4] + part - 1) % sectors]
            for c in range(width):
                joined[r, part * width + c] = own[c]


@compiled
def add_across(said: FloatArray, where: IntArray, across: FloatArray) -> None:
    """Add what tiles say to those above, below, further in and further out.

    Args:
        said: (N, 2, 4, 3, 8, C) to add to.
        where: (R, 5) of ``list_tiles``.
        across: (R, 3, 3, C) what each says to the tile one down, level or one up, and one inwards,
            level or one outwards: the reverse of where the hearer finds it.
    """
    heights, radii, width = said.shape[2], said.shape[3], said.shape[5]
    for r in range(len(where)):
        n, s, a = where[r, 0], where[r, 1], where[r, 4]
        for up in range(3):
            i = where[r, 2] + 1 - up
            if i < 0 or i >= heights:
                continue
            for out in range(3):
                j = where[r, 3] + 1 - out
                if 0 <= j < radii:
                    for c in range(width):
                        said[n, s, i, j, a, c] += across[r, up, out, c]
