"""The matcher's training: what counts as one place, the loss by hand, resumable, usable."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from skipnet.commands.train import main
from skipnet.geometry import transform_points
from skipnet.networks.catalog import find_deep, find_matcher, load_matcher
from skipnet.networks.names import DEEP, MATCHER, MATCHER_WEIGHTS
from skipnet.networks.tokens import Tokens
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import DEEP_TEST, DEEP_TRAINING
from skipnet.training.data.factory import Factory, make_scans
from skipnet.training.data.token_pairs import Hiding, TokenPair, make_token_pair, token_pair
from skipnet.training.experiments.matching import TrainableMatcher
from skipnet.training.schedule import Schedule
from skipnet.training.tasks.matching import MatchingPlan, MatchingTask, matching_loss
from skipnet.training.trainer import Outcome, Trainer

WIDTHS = {"units": 12, "output": 6, "width": 8, "heads": 2, "layers": 1}


def drawn_pair(seed: int, oriented: bool = True) -> TokenPair:
    """Twelve keypoints, seen again in another order and another frame."""
    rng = np.random.default_rng(seed)
    order, count = rng.permutation(12), 12
    units = rng.random((count, WIDTHS["units"])).astype(np.float16)
    places = rng.uniform(-20, 20, (count, 3)).astype(np.float32)
    axes = rng.normal(size=(count, 3)).astype(np.float32)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    source = Tokens(units[order], places[order] @ turn, axes[order] @ turn)
    target = Tokens(units, places, axes)
    if not oriented:
        target = Tokens(*(np.concatenate([one, one]) for one in (units, places)), None)
        target = target._replace(axes=np.concatenate([axes, -axes]))
    return TokenPair(source, target, places[order], axes[order], oriented)


def test_one_place_is_near_and_on_one_side() -> None:
    pair = drawn_pair(0)
    everything = np.arange(12)
    same = pair.same(everything, everything)
    distance = np.linalg.norm(pair.true_voxels[:, None] - pair.target.places_voxels, axis=2)
    assert (same.sum(axis=1) >= 1).all() and not same[distance >= 2].any()
    blind = drawn_pair(0, oriented=False)
    turned = blind.same(everything, np.arange(24))
    np.testing.assert_array_equal(turned[:, :12], same)
    assert not (turned[:, 12:] & (distance < 1e-6)).any()  # its own back is not the place


def test_a_lesson_shows_what_is_same_among_the_drawn() -> None:
    rng = np.random.default_rng(0)
    for oriented in (True, False):
        pair = drawn_pair(1, oriented)
        for _ in range(6):
            lesson = pair.draw(9, rng)
            assert lesson.same.shape == (len(lesson.source.units), len(lesson.target.units))
            assert len(lesson.source.units) == 9
            assert len(lesson.target.units) == (9 if oriented else 12)
            rows, columns = torch.nonzero(lesson.same, as_tuple=True)
            one, other = lesson.source.units[rows], lesson.target.units[columns]
            assert len(rows) and (one == other).all(dim=1).float().mean() > 0.5


def test_what_is_hidden_is_cut_away_dropped_and_moved() -> None:
    rng, pair = np.random.default_rng(0), drawn_pair(2)
    counts = [len(pair.draw(12, rng, Hiding(cropped_share=0.99)).source.units) for _ in range(40)]
    assert min(counts) == 6 < max(counts)  # half of a scan stays at least
    whole = pair.whole()
    lesson = pair.draw(12, rng, Hiding(dropped_share=0.25))
    units = torch.cat([lesson.source.units, lesson.target.units])
    shown = torch.cat([whole.source.units, whole.target.units])
    hidden = (units == 0).float().mean()
    assert 0.15 < hidden < 0.35
    assert units[units > 0].max() <= shown.max() / 0.75 + 1e-6
    assert abs(units.mean() / shown.mean() - 1) < 0.15  # as much is said as before
    blind, jitter = drawn_pair(2, oriented=False), Hiding(jitter_voxels=0.5)
    moved = torch.stack([blind.draw(12, rng, jitter).source.places_voxels for _ in range(200)])
    off = moved - blind.whole().source.places_voxels
    assert abs(float(off.std()) - 0.5) < 0.03 and abs(float(off.mean())) < 0.03


def test_the_loss_by_hand() -> None:
    alike = torch.tensor([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    same = torch.tensor([[True, False, False], [False, False, False]])
    partner_s, partner_t = torch.tensor([1.0, -1.0]), torch.tensor([0.5, 0.0, -2.0])
    forward = np.log(np.exp(2) + 2) - 2
    backward = np.log(np.exp(2) + 1) - 2
    unsure_s = np.mean(np.log1p(np.exp([-1.0, -1.0])))
    unsure_t = np.mean(np.log1p(np.exp([-0.5, 0.0, -2.0])))
    expected = (forward + backward + unsure_s + unsure_t) / 2
    found = matching_loss(alike, partner_s, partner_t, same)
    assert float(found) == pytest.approx(expected, rel=1e-5)
    nothing = matching_loss(alike, partner_s, partner_t, torch.zeros_like(same))
    assert torch.isfinite(nothing)


def test_keypoints_of_simulated_scans_lie_where_the_truth_brings_them() -> None:
    number, network = DEEP_TEST.scene(3), find_deep(DEEP, "network")
    scans = make_scans(number)
    assert scans is not None
    pair = token_pair(scans, network, 100)
    size_m = scans.target.voxel_size_m
    gaps = []
    for true, own in ((pair.true_voxels, pair.source.places_voxels),):
        turned = transform_points(scans.T_target_source, own.astype(float) * size_m) / size_m
        gaps.append(np.ptp(true - turned, axis=0).max())
    assert max(gaps) < 1e-3  # but for one shift
    again = make_token_pair(number, DEEP, 100)
    if again is not None:
        np.testing.assert_array_equal(again.source.units, pair.source.units)


class Shelf(Executor):
    """Answers at once."""

    def submit(self, make: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[TokenPair | None] = Future()
        future.set_result(drawn_pair(args[0], oriented=args[0] % 2 == 0))
        return future


def test_a_training_resumes_to_the_bit_and_learns(tmp_path: Path) -> None:
    def train(checkpoint: Path | None = None, killed_at: int = -1) -> Outcome[TrainableMatcher]:
        def kill(step: int, loss: float) -> None:
            losses.append(loss)
            if step == killed_at:
                raise KeyboardInterrupt

        losses.clear()
        torch.manual_seed(0)
        network = TrainableMatcher(**WIDTHS)
        network.mixed_precision = True
        make = partial(make_token_pair, describes=DEEP)
        lessons = Factory(make, DEEP_TRAINING, 8, scans_per_step=2, uses=4, pool=Shelf())
        unseen = [drawn_pair(seed) for seed in range(5)]
        task = MatchingTask(lessons, MatchingPlan(2, 9, Hiding(0.1, 0.02, 0.02)), unseen, 1)
        schedule = Schedule(40, 10, "40 steps", "warm_cosine")
        optimizer = partial(torch.optim.AdamW, lr=1e-2)
        return Trainer(
            task, network, optimizer, schedule, checkpoint, on_step=kill, threads=1
        ).run()

    losses: list[float] = []
    checkpoint = tmp_path / "checkpoint.pt"
    whole = train()
    assert np.mean(losses[-10:]) < 0.8 * np.mean(losses[:10])
    assert whole.best.score > 0.8
    with pytest.raises(KeyboardInterrupt):
        train(checkpoint, killed_at=35)
    resumed = train(checkpoint)
    assert resumed.history == whole.history
    for name, weight in whole.network.arrays().items():
        np.testing.assert_array_equal(weight, resumed.network.arrays()[name])


def test_train_py_writes_a_matcher_that_registers(tmp_path: Path) -> None:
    counts = {"steps": 4, "validate_every": 2, "window": 8, "validation_pairs": 1, "test_pairs": 2}
    counts |= {"keypoints": 60, "width": 16, "heads": 2, "layers": 1, "threads": 1}
    options = [f"matcher.{name}={count}" for name, count in counts.items()]
    assert main(["experiment=matcher", "data.workers=1", f"output_dir={tmp_path}", *options]) == 0
    path = tmp_path / "matcher.npz"
    matcher, deep = load_matcher(path), find_deep(DEEP, "network")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert set(summary["unseen"]) == {"learned", "network alone", "fpfh"}
    assert matcher.card["scores"]["learned"] == summary["unseen"]["learned"]["all"]
    assert matcher.card["describes"] == deep.digest
    pair = simulate_pair("oblique", 1, points=20_000).pair
    config = RegistrationConfig([Generator.deep], matcher=str(path))
    result = register(pair.source_m, pair.target_m, config=config)
    assert result.T_target_source.shape == (4, 4)
    network = TrainableMatcher(**matcher.card["widths"])
    network.begin(deep, str(path))
    for name, weight in matcher.weights.items():
        np.testing.assert_array_equal(network.arrays()[name], weight)
    with pytest.raises(ValueError, match=r"matcher\.start"):
        TrainableMatcher(**matcher.card["widths"] | {"width": 8}).begin(deep, str(path))


def test_the_shipped_weights_are_small_and_their_card_says_where_they_come_from() -> None:
    card = find_matcher(MATCHER, find_deep(DEEP, "network")).card
    assert card["training_data"]["origin"].startswith("simulation only")
    assert {"seed", "device", "hours", "reached", "scores"} <= card.keys()
    learned, alone = (card["scores"][name]["inlier_ratio"] for name in ("learned", "network alone"))
    assert learned > alone
    assert MATCHER_WEIGHTS.stat().st_size < 2_000_000
