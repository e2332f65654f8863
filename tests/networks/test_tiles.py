"""Tiles that hold nothing say what an empty grid says: the network leaves them out."""

from __future__ import annotations

import numpy as np

from skipnet.features.grids import GRID_SHAPE
from skipnet.networks.numpy_deep import DeepNumpyNetwork, shapes_of
from skipnet.networks.tiles import list_tiles
from skipnet.networks.torch_network import TorchNetwork

WIDTHS = {"local": 12, "hidden": 20, "output": 7, "blocks": 2}


def thinned_grids(seed: int, share: float) -> np.ndarray:
    """30 grids of which so many cells hold something, the first one none."""
    rng = np.random.default_rng(seed)
    grids = rng.normal(size=(30, *GRID_SHAPE)).astype(np.float32)
    grids[rng.random((30, *GRID_SHAPE[:-1])) > share] = 0
    grids[0] = 0
    return grids


def test_grids_with_empty_tiles_are_read_as_torch_reads_them() -> None:
    for blocks in (1, 2):
        widths = WIDTHS | {"blocks": blocks}
        rng = np.random.default_rng(blocks)
        weights = {
            name: rng.normal(size=shape).astype(np.float32) / np.sqrt(np.float32(shape[-1]))
            for name, shape in shapes_of(**widths).items()
        }
        card, grids = {"widths": widths}, thinned_grids(3, 0.03)
        held, near = list_tiles(grids)
        assert 0 < len(held) < len(near) < 0.8 * 30 * 192
        expected = TorchNetwork(weights, card).read(grids)
        found = DeepNumpyNetwork(weights, card).read(grids)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-5)
        np.testing.assert_allclose(found[1], expected[1], atol=1e-4)


def test_tiles_are_listed_by_the_cells_they_hold() -> None:
    grids = thinned_grids(4, 0.01)
    held, near = (set(map(tuple, places.tolist())) for places in list_tiles(grids))
    for n, s, i, j, a in np.argwhere(grids[..., 0] != 0):
        for tile in range(8):
            inside = int(a) in [(2 * tile - 1 + step) % 16 for step in range(4)]
            assert not inside or (n, s, i // 2, j // 2, tile) in held
    for n, s, i, j, tile in held:
        cells = grids[n, s, 2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
        assert cells[:, :, [(2 * tile - 1 + step) % 16 for step in range(4)]].any()
        assert {(n, s, i, j, (tile + step) % 8) for step in (-1, 0, 1)} <= near
