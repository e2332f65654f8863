"""The matcher: NumPy computes what torch does, and no motion of either scan changes anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from skipnet.networks.catalog import find_deep, find_matcher, find_network, save_network
from skipnet.networks.describing import matched
from skipnet.networks.matcher import MatcherNetwork, matches
from skipnet.networks.matcher import relations as relations_in_torch
from skipnet.networks.names import DEEP, DEEP_WEIGHTS
from skipnet.networks.numpy_matcher import NumpyMatcher, matcher_shapes
from skipnet.networks.relations import RELATIONS, relations
from skipnet.networks.tokens import Tokens, tokens_of
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.glimpses import EYES, glimpse
from skipnet.simulation.seeds import DEEP_TEST
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import build_skipmap
from skipnet.types import FloatArray

SMALL = {"units": 10, "output": 6, "width": 8, "heads": 2, "layers": 2}


def some_tokens(count: int, seed: int) -> Tokens:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    units = rng.random((count, SMALL["units"]))
    places_voxels = rng.uniform(-30, 30, (count, 3))
    return Tokens(*(values.astype(np.float32) for values in (units, places_voxels, axes)))


def in_torch(tokens: Tokens) -> Tokens:
    return Tokens(*map(torch.from_numpy, tokens))


def moved(tokens: Tokens, seed: int) -> Tokens:
    turn = Rotation.random(random_state=seed).as_matrix()
    places = tokens.places_voxels @ turn.T + [5.0, -20.0, 3.0]
    return Tokens(tokens.units, places.astype(np.float32), (tokens.axes @ turn.T).astype("f4"))


@pytest.fixture(scope="module")
def network() -> MatcherNetwork:
    """Every number drawn at random: a layer that is left out would be seen."""
    torch.manual_seed(0)
    network = MatcherNetwork(**SMALL).eval()
    with torch.no_grad():
        for weight in network.parameters():
            weight.add_(0.3 * torch.randn(weight.shape))
    return network


@pytest.fixture(scope="module")
def weights(network: MatcherNetwork) -> dict[str, FloatArray]:
    return {name: value.numpy() for name, value in network.state_dict().items()}


@pytest.fixture(scope="module")
def matcher(weights: dict[str, FloatArray]) -> NumpyMatcher:
    return NumpyMatcher(weights, {"widths": SMALL})


@pytest.mark.parametrize("oriented", [True, False])
def test_it_computes_what_torch_does(
    oriented: bool, network: MatcherNetwork, matcher: NumpyMatcher
) -> None:
    source, target = some_tokens(40, 1), some_tokens(70, 2)
    with torch.no_grad():
        expected = matches(*network(in_torch(source), in_torch(target), oriented)).numpy()
    found = matcher.match(source, target, oriented)
    assert found.shape == (40, 70) and found.std() > 0.5
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_its_weights_are_those_of_the_torch_network(weights: dict[str, FloatArray]) -> None:
    assert matcher_shapes(**SMALL) == {name: value.shape for name, value in weights.items()}
    with pytest.raises(ValueError, match="expected"):
        NumpyMatcher(weights, {"widths": SMALL | {"heads": 4}})


def test_relations_are_those_in_torch_and_go_by_hand() -> None:
    tokens = some_tokens(30, 3)
    table = np.empty((30, 30, RELATIONS), np.float32)
    for oriented in (True, False):
        relations(tokens.places_voxels, tokens.axes, oriented, table)
        expected = relations_in_torch(in_torch(tokens), oriented).numpy()
        np.testing.assert_allclose(table, expected, atol=2e-5)
    places = np.array([[0, 0, 0], [6, 0, 0]], np.float32)
    axes = np.array([[1, 0, 0], [0, 1, 0]], np.float32)
    two = np.empty((2, 2, RELATIONS), np.float32)
    relations(places, axes, True, two)
    fading = np.exp(-6 / np.array([6, 20, 60]))
    np.testing.assert_allclose(two[0, 1], [np.log1p(1.5), *fading, 1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(two[1, 0], [np.log1p(1.5), *fading, 0, -1, 0], atol=1e-6)


@pytest.mark.parametrize("oriented", [True, False])
def test_no_motion_of_either_scan_changes_anything(oriented: bool, matcher: NumpyMatcher) -> None:
    source, target = some_tokens(40, 4), some_tokens(50, 5)
    found = matcher.match(source, target, oriented)
    again = matcher.match(moved(source, 1), moved(target, 2), oriented)
    np.testing.assert_allclose(again, found, atol=2e-3)
    order = np.random.default_rng(6).permutation(40)
    shuffled = matcher.match(Tokens(*(values[order] for values in source)), target, oriented)
    np.testing.assert_allclose(shuffled, found[order], atol=2e-4)
    swapped = matcher.match(target, source, oriented)
    np.testing.assert_allclose(swapped.T, found, atol=2e-4)


def test_signs_of_axes_count_only_where_they_are_known(matcher: NumpyMatcher) -> None:
    source, target = some_tokens(40, 7), some_tokens(50, 8)
    signs = np.random.default_rng(9).choice([-1, 1], (40, 1)).astype(np.float32)
    other = source._replace(axes=source.axes * signs)
    blind = [matcher.match(tokens, target, False) for tokens in (source, other)]
    np.testing.assert_allclose(*blind, atol=2e-4)
    seen = [matcher.match(tokens, target, True) for tokens in (source, other)]
    assert np.abs(seen[0] - seen[1]).max() > 0.05


def test_tokens_show_both_sides_where_they_are_asked_for() -> None:
    rng = np.random.default_rng(0)
    cloud_m, _, _ = glimpse("kitchen", DEEP_TEST.scene(0), EYES["camera"], rng)
    skipmap = build_skipmap(cloud_m, choose_voxel_size(cloud_m))
    network = find_deep(DEEP, "network")
    rows, one = tokens_of(skipmap, network, False, 40)
    both_rows, both = tokens_of(skipmap, network, True, 60)
    np.testing.assert_array_equal(both_rows, np.concatenate([rows, rows]))
    np.testing.assert_allclose(both.units[:40], one.units, atol=1e-5)
    np.testing.assert_array_equal(both.axes, np.concatenate([one.axes, -one.axes]))
    turned = network.units(network.turned_over(network.cut(skipmap, rows)))
    np.testing.assert_allclose(both.units[40:], turned, atol=1e-5)
    apart_m = np.linalg.norm(np.diff(skipmap.centroids_m[rows], axis=0), axis=1)
    apart_voxels = np.linalg.norm(np.diff(one.places_voxels, axis=0), axis=1)
    np.testing.assert_allclose(apart_voxels * skipmap.voxel_size_m, apart_m, rtol=1e-4)


def test_keypoints_take_each_other_for_one_place(matcher: NumpyMatcher) -> None:
    source, target = some_tokens(20, 10), some_tokens(30, 11)
    rows_s, rows_t = np.arange(100, 120), np.arange(200, 230)
    of_s, of_t, unlikely = matched(matcher, (rows_s, source), (rows_t, target), True)
    table = matcher.match(source, target, True)
    np.testing.assert_allclose(unlikely, -table[of_s - 100, of_t - 200])
    for i, j in zip(of_s - 100, of_t - 200, strict=True):
        assert table[i, j] == table[i].max() == table[:, j].max()
    more = matched(matcher, (rows_s, source), (rows_t, target), True, choices=2)
    assert set(zip(of_s, of_t, strict=True)) < set(zip(*more[:2], strict=True))


def test_a_matcher_belongs_to_one_network(tmp_path: Path, weights: dict[str, FloatArray]) -> None:
    deep, path = find_network(DEEP), tmp_path / "matcher.npz"
    card = {"architecture": "matcher", "widths": SMALL, "describes": "0123456789abcdef"}
    save_network(weights, card, path)
    with pytest.raises(ValueError, match="learned from what the network 0123456789abcdef"):
        find_matcher(str(path), deep)
    with pytest.raises(ValueError, match="architecture is matcher, not"):
        find_network(str(path))
    cloud_m = np.random.default_rng(0).random((500, 3))
    for options, words in (
        ({"matcher": str(path)}, "take matcher=null"),
        ({"deep_network": "small"}, "expected a deep network"),
    ):  # at once, whether or not it will be needed
        with pytest.raises(ValueError, match=words):
            register(cloud_m, cloud_m, config=RegistrationConfig(**options))
    alone = RegistrationConfig([Generator.planes], matcher=str(path))
    assert register(cloud_m, cloud_m, config=alone).status is not None
    with pytest.raises(ValueError, match="matcher=matchr: no such network or file; did you mean"):
        RegistrationConfig([Generator.deep], matcher="matchr")
    with pytest.raises(ValueError, match="architecture is deep, not matcher"):
        find_matcher(str(DEEP_WEIGHTS), deep)
    with pytest.raises(ValueError, match="deep_network=small: expected a deep network"):
        find_deep("small", "deep_network")
