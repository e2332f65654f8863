"""The deep network without torch: it computes what torch does, once per scan."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from skipnet.features.grids import GRID_SHAPE
from skipnet.networks.catalog import find_network
from skipnet.networks.describing import describe_keypoints
from skipnet.networks.numpy_deep import DeepNumpyNetwork, shapes_of
from skipnet.networks.torch_network import TorchNetwork
from skipnet.scans.describing import describe
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.types import FloatArray

SMALL = {"local": 8, "hidden": 16, "output": 12, "blocks": 1}


def weights_of(widths: dict[str, int]) -> dict[str, FloatArray]:
    """Every number drawn at random: a layer that is left out would be seen."""
    rng = np.random.default_rng(0)
    return {
        name: (rng.normal(0, 0.3, shape) + (name.endswith("norm.weight"))).astype(np.float32)
        for name, shape in shapes_of(**widths).items()
    }


@pytest.mark.parametrize(
    "widths", [SMALL, {"local": 12, "hidden": 20, "output": 7, "blocks": 2}], ids=["one", "two"]
)
def test_it_computes_what_torch_does(widths: dict[str, Any]) -> None:
    weights, card = weights_of(widths), {"widths": widths}
    grids = np.random.default_rng(1).normal(size=(50, *GRID_SHAPE)).astype(np.float32)
    expected = TorchNetwork(weights, card).read(grids)
    described, matchable = DeepNumpyNetwork(weights, card).read(grids)
    assert np.abs(described).max() > 0.1
    np.testing.assert_allclose(described, expected[0], atol=1e-5)
    np.testing.assert_allclose(matchable, expected[1], atol=1e-4)


def test_its_weights_are_those_of_the_torch_network() -> None:
    from skipnet.networks.deep import DeepNetwork

    state = DeepNetwork(**SMALL).state_dict()
    assert shapes_of(**SMALL) == {name: tuple(value.shape) for name, value in state.items()}


def test_other_weights_and_patches_are_refused() -> None:
    weights = weights_of(SMALL)
    model = DeepNumpyNetwork(weights, {"widths": SMALL})
    with pytest.raises(ValueError, match="patches must be"):
        model.read(np.zeros((3, 5, 100)))
    with pytest.raises(ValueError, match="knows no classes"):
        model.classify(np.zeros((3, 125)), np.zeros((3, *GRID_SHAPE)))
    with pytest.raises(ValueError, match="expected"):
        DeepNumpyNetwork(weights, {"widths": SMALL | {"output": 9}})
    none, logits = model.read(np.zeros((0, *GRID_SHAPE), np.float32))
    assert none.shape == (0, 12) and logits.shape == (0,)


def test_a_scan_is_described_once_per_network_and_keeps_it() -> None:
    pair = simulate_pair("oblique", 2, points=20_000).pair
    scan, _ = describe((pair.source_m, pair.target_m), ("auto", "auto"))
    network = DeepNumpyNetwork(weights_of(SMALL), {"widths": SMALL})
    rows, described = scan.keypoints(network, False)
    expected = describe_keypoints(scan.skipmap, network)
    np.testing.assert_array_equal(rows, expected[0])
    np.testing.assert_array_equal(described, expected[1])
    assert scan.keypoints(network, False)[1] is described
    assert scan.keypoints(network, False)[1] is described
    assert len(scan.keypoints(network, True)[0]) == pytest.approx(2 * len(rows), abs=1)
    assert len(scan.keypoints(scan.network, False)[0]) > len(rows)
    again = pickle.loads(pickle.dumps(scan))
    np.testing.assert_array_equal(again.keypoints(network, False)[1], described)


def test_it_needs_no_torch() -> None:
    code = (
        "import sys, skipnet.registration.generators, skipnet.networks.numpy_deep;"
        "assert 'torch' not in sys.modules and 'open3d' not in sys.modules"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("name", ["shipped", "deep"])
def test_a_network_prints_as_a_line(name: str) -> None:
    network = find_network(name)
    assert network.digest in repr(network) and len(repr(network)) < 120
