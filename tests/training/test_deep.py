"""The deep network, and the factory that feeds it: repeatable, resumable, usable by its file."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from skipnet.commands.train import main
from skipnet.features.grids import GRID_SHAPE
from skipnet.geometry import transform_points
from skipnet.metrics.correspondences import true_correspondences
from skipnet.networks.catalog import find_network, rounded, save_network
from skipnet.networks.describing import correspond
from skipnet.networks.names import DEEP, DEEP_WEIGHTS
from skipnet.networks.torch_network import TorchNetwork
from skipnet.registration.answer import Answer
from skipnet.registration.generators import asked
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.pipeline import register
from skipnet.registration.searching import is_enough
from skipnet.registration.verdict import Verdict
from skipnet.scans.describing import describe
from skipnet.simulation.scanning.glimpses import EYES, glimpse
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import DEEP_TEST, DEEP_TRAINING
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import build_skipmap
from skipnet.training.data.factory import KINDS, PatchFactory, make_pairs, make_scans
from skipnet.training.data.pairs import PatchPairs, digest
from skipnet.training.experiments.deep_descriptor import TrainableDeepNetwork
from skipnet.training.schedule import Schedule
from skipnet.training.task import Judgement
from skipnet.training.tasks.descriptor import DescriptorTask, StepPlan
from skipnet.training.trainer import Outcome, Trainer
from skipnet.types import FloatArray, Pair, Status


@pytest.fixture(scope="module")
def grids() -> FloatArray:
    return np.random.default_rng(0).random((30, *GRID_SHAPE)).astype(np.float32)


@pytest.fixture(scope="module")
def network() -> TrainableDeepNetwork:
    torch.manual_seed(0)
    return TrainableDeepNetwork(local=8, hidden=16, output=12, blocks=1).eval()


def test_what_is_used_is_what_was_trained(network: TrainableDeepNetwork, grids: FloatArray) -> None:
    described, matchable = network.model().read(grids)
    with torch.no_grad():
        expected = network.recognise(network(torch.from_numpy(grids)))
    np.testing.assert_allclose(described, expected[0].numpy(), atol=1e-5)
    np.testing.assert_allclose(matchable, expected[1].numpy(), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(described, axis=1), 1, atol=1e-5)


def test_a_turn_by_two_sectors_changes_nothing(
    network: TrainableDeepNetwork, grids: FloatArray
) -> None:
    model = network.model()
    turned = model.read(np.roll(grids, 4, axis=4))[0]
    np.testing.assert_allclose(turned, model.read(grids)[0], atol=1e-5)
    mirrored = model.read(np.ascontiguousarray(grids[:, :, :, :, ::-1]))[0]
    assert np.abs(mirrored - model.read(grids)[0]).max() > 1e-3


def test_what_it_cannot_do_is_said(network: TrainableDeepNetwork, grids: FloatArray) -> None:
    model = network.model()
    with pytest.raises(ValueError, match="knows no classes"):
        model.classify(np.zeros((30, 125)), grids)
    with pytest.raises(ValueError, match="patches must be"):
        model.read(grids[:, :1])
    with pytest.raises(ValueError, match="Missing key"):
        TorchNetwork({}, {"widths": network.widths})
    with pytest.raises(ValueError, match="device=cudda: did you mean cuda"):
        RegistrationConfig(device="cudda")


@pytest.mark.parametrize("name", ["cuda", "mps"])
def test_every_device_reads_the_same(
    name: str, network: TrainableDeepNetwork, grids: FloatArray
) -> None:
    weights, card = network.arrays(), {"widths": network.widths}
    try:
        there = TorchNetwork(weights, card, name)
    except ValueError as error:
        assert f"device={name}: torch" in str(error)
        return
    here = network.model().read(grids)[0]
    np.testing.assert_allclose(there.read(grids)[0], here, atol=1e-2)


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_gives_scans_and_their_true_motion(kind: str) -> None:
    family = KINDS[kind].families[0]
    gaps_m = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        source_m, target_m, T = KINDS[kind].make(family, DEEP_TEST.scene(seed), rng)
        distance_m, _ = cKDTree(target_m).query(transform_points(T, source_m))
        gaps_m.append(np.quantile(distance_m, 0.05))
    size_m = np.ptp(target_m, axis=0).max()
    assert min(gaps_m) < 0.01 * size_m


def test_a_single_view_stands_at_its_origin() -> None:
    rng = np.random.default_rng(0)
    source_m, target_m, _ = glimpse("kitchen", DEEP_TEST.scene(0), EYES["camera"], rng)
    for cloud_m in (source_m, target_m):
        assert cloud_m[:, 2].min() > 0  # it looks along its z
        assert np.linalg.norm(cloud_m, axis=1).max() < 1.1 * EYES["camera"].max_range_m


def test_a_number_always_gives_the_same_pairs() -> None:
    number = DEEP_TEST.first
    one, other = (make_pairs(number, 20) for _ in range(2))
    assert one is not None and other is not None and len(one) == 20
    assert digest([one]) == digest([other])
    assert one.source.shape == (20, *GRID_SHAPE)
    scans = make_scans(number)
    assert scans is not None and len(true_correspondences(scans)[0]) >= 100


class Shelf(Executor):
    """Answers at once, and notes what it was asked for; number 3 shares too little."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def submit(self, make: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        (number,) = args
        self.asked.append(number)
        rng = np.random.default_rng(number)
        patches = rng.random((8, *GRID_SHAPE)).astype(np.float16)
        places = 10 * np.arange(24, dtype=np.float32).reshape(8, 3)
        future: Future[PatchPairs | None] = Future()
        empty = number == DEEP_TRAINING.first + 3
        future.set_result(None if empty else PatchPairs(patches, patches, places))
        return future


def shelf_factory() -> PatchFactory:
    make = partial(make_pairs, per_scans=8)
    return PatchFactory(make, DEEP_TRAINING, window=8, scans_per_step=2, uses=4, pool=Shelf())


def test_the_window_moves_on_and_depends_on_the_step_alone() -> None:
    whole = shelf_factory()
    seen = [digest(whole.pairs_at(step)) for step in range(60)]
    assert len(whole.pairs_at(59)) == 8 and len(shelf_factory().pairs_at(0)) == 7
    assert len(set(seen)) == 30  # a new pair every other step
    late = shelf_factory()
    assert digest(late.pairs_at(59)) == seen[59]
    assert isinstance(late._pool, Shelf) and min(late._pool.asked) > DEEP_TRAINING.first + 20


def test_a_training_on_the_factory_resumes_to_the_bit(tmp_path: Path) -> None:
    class Counting(DescriptorTask):
        def judge(self, network: Any) -> Judgement:
            return Judgement(float(network.output.weight.abs().sum()))

    def train(checkpoint: Path | None = None, killed_at: int = -1) -> Outcome[TrainableDeepNetwork]:
        def kill(step: int, loss: float) -> None:
            if step == killed_at:
                raise KeyboardInterrupt

        torch.manual_seed(0)
        network = TrainableDeepNetwork(local=8, hidden=16, output=12, blocks=1)
        network.mixed_precision = True
        task = Counting(shelf_factory(), StepPlan(2, 6, 0.07), [], 1)
        schedule = Schedule(30, 10, "30 steps", "warm_cosine")
        make = partial(torch.optim.AdamW, lr=1e-3)
        return Trainer(task, network, make, schedule, checkpoint, on_step=kill).run()

    checkpoint = tmp_path / "checkpoint.pt"
    whole = train()
    with pytest.raises(KeyboardInterrupt):
        train(checkpoint, killed_at=25)
    resumed = train(checkpoint)
    assert resumed.history == whole.history
    for name, weight in whole.network.arrays().items():
        np.testing.assert_array_equal(weight, resumed.network.arrays()[name])


def test_train_py_writes_a_deep_network_that_registers(tmp_path: Path) -> None:
    counts = {"steps": 4, "validate_every": 2, "window": 8, "validation_pairs": 1, "test_pairs": 2}
    counts |= {"scans_per_step": 2, "patches_per_step": 32, "patches_per_scans": 20}
    counts |= {"local_channels": 8, "hidden_units": 16, "first": 100, "threads": 1}
    options = [f"deep.{name}={count}" for name, count in counts.items()]
    assert main(["experiment=deep", "data.workers=1", f"output_dir={tmp_path}", *options]) == 0
    network = find_network(str(tmp_path / "descriptor.npz"))
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["unseen"]) == {"learned", "fpfh", "small network"}
    assert network.card["scores"]["learned"] == summary["unseen"]["learned"]["all"]
    assert network.card["architecture"] == "deep"
    pair = simulate_pair("oblique", 1, points=20_000).pair
    config = RegistrationConfig([Generator.descriptors], network=str(tmp_path / "descriptor.npz"))
    result = register(pair.source_m, pair.target_m, config=config)
    assert result.details["network"] == network.digest
    scans = make_scans(DEEP_TEST.first)
    assert scans is not None
    rows_s, rows_t, distance = correspond(scans.source, scans.target, network, 100)
    assert len(rows_s) == len(rows_t) == len(distance) > 0


def test_the_shipped_weights_are_small_and_their_card_says_where_they_come_from() -> None:
    card = find_network(DEEP).card
    assert card["training_data"]["origin"].startswith("simulation only")
    later = {"level_lidar"}  # the one kind that the factory did not make yet
    assert card["training_data"]["kinds"].keys() == KINDS.keys() - later
    assert {"seed", "device", "hours", "reached", "scores"} <= card.keys()
    assert card["scores"]["learned"]["pairs"] > 0
    assert DEEP_WEIGHTS.stat().st_size < 4_000_000


def test_a_scan_turned_by_quarters_is_described_alike() -> None:
    """They lead voxels to voxels: all that is left is where sectors begin."""
    rng = np.random.default_rng(0)
    cloud_m, _, _ = glimpse("kitchen", DEEP_TEST.scene(0), EYES["camera"], rng)
    size_m, network = choose_voxel_size(cloud_m), find_network(DEEP)
    turn = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    one, other = (
        build_skipmap(points_m, size_m, np.zeros(3)) for points_m in (cloud_m, cloud_m @ turn.T)
    )
    described, again = (network.read(network.cut(m, np.arange(len(m))))[0] for m in (one, other))
    distance_m, row = cKDTree(other.centroids_m).query(one.centroids_m @ turn.T)
    same = distance_m < 1e-6
    assert same.mean() > 0.9
    alike = np.einsum("kd,kd->k", described[same], again[row[same]])
    shuffled = rng.permutation(described)
    assert np.median(alike) > 0.95
    assert np.median(np.einsum("kd,kd->k", described, shuffled)) < 0.5


def test_a_training_goes_on_from_weights(tmp_path: Path, network: TrainableDeepNetwork) -> None:
    path = tmp_path / "start.npz"
    save_network(network.arrays(), {"architecture": "deep", "widths": network.widths}, path)
    going_on = TrainableDeepNetwork(**network.widths)
    going_on.go_on_from(find_network(str(path)))
    going_on.fit_scaling(torch.full((3, *GRID_SHAPE), 5.0))  # keeps what it has
    for name, weight in rounded(network.arrays()).items():
        np.testing.assert_array_equal(going_on.arrays()[name], weight)
    with pytest.raises(ValueError, match=r"deep\.start"):
        TrainableDeepNetwork(**network.widths | {"local": 4}).go_on_from(find_network(str(path)))
    with pytest.raises(ValueError, match=r"deep\.start"):
        going_on.go_on_from(find_network())


def test_the_last_resorts_are_asked_only_while_nothing_is_registered() -> None:
    unsure = replace(Answer.none(), verdict=Verdict(Status.REGISTERED, 0.6, ""))
    for generator in (Generator.deep, Generator.fpfh):
        assert is_enough(unsure, generator) and not is_enough(Answer.none(), generator)
    assert not is_enough(unsure, Generator.descriptors)


def test_the_deep_network_is_asked_where_a_scan_shows_one_side_alone() -> None:
    rng = np.random.default_rng(0)
    views = glimpse("kitchen", DEEP_TEST.scene(0), EYES["camera"], rng)[:2]
    pair = simulate_pair("oblique", 1, points=20_000).pair
    narrow, round_ = (describe(two, ("auto", "auto")) for two in (views, pair_of(pair)))
    blind = describe(pair_of(pair), (None, None))
    assert all(scan.is_narrow for scan in (*narrow, *blind))
    assert not any(scan.is_narrow for scan in round_)
    config = RegistrationConfig()
    assert asked(config, *round_) == config.generators[:-1]
    for scans in (narrow, blind, (narrow[0], round_[1])):
        assert asked(config, *scans) == config.generators
    alone = RegistrationConfig([Generator.planes, Generator.deep])
    assert asked(alone, *round_) == alone.generators


def pair_of(pair: Pair) -> tuple[FloatArray, FloatArray]:
    return pair.source_m, pair.target_m


def test_a_voxel_at_the_sensor_lies_in_no_direction(recwarn: pytest.WarningsRecorder) -> None:
    source, _ = describe(pair_of(simulate_pair("oblique", 1, points=20_000).pair), ("auto", "auto"))
    assert source.viewpoint_m is not None
    centroids_m = source.skipmap.centroids_m.copy()
    centroids_m[0] = source.viewpoint_m
    there = replace(source, skipmap=replace(source.skipmap, centroids_m=centroids_m))
    assert not there.is_narrow and not recwarn.list
