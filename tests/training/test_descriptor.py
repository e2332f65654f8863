"""The learned descriptor: NumPy against torch, invariances, training from simulation alone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from skipnet.benchmark.methods import Task, make_method
from skipnet.benchmark.options import EvaluateConfig
from skipnet.clouds.formats.reading import _READERS
from skipnet.features.cylinders import SECTOR_SIZE, SECTORS, choose_keypoints, cylinder_patches
from skipnet.features.matching import mutual_nearest
from skipnet.metrics.classes import confusion_matrix, macro_f1
from skipnet.metrics.correspondences import (
    Keypoints,
    Match,
    TwoScans,
    by_fpfh,
    by_overlap,
    inlier_ratio,
    keypoints_of,
    summarise,
    true_correspondences,
)
from skipnet.networks.catalog import find_network, load_network, save_network
from skipnet.networks.describing import classify_voxels, correspond, describe_keypoints
from skipnet.networks.devices import find_device
from skipnet.networks.names import SHIPPED_WEIGHTS
from skipnet.networks.numpy_network import SmallNetwork
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scanning.recipe import Recipe
from skipnet.training.data import labelled as dataset
from skipnet.training.data.labelled import Samples
from skipnet.training.data.pairs import PatchPairs, digest, make_patch_pairs, simulate_two_scans
from skipnet.training.networks.cyclic import DescriptorNetwork, Strongest, Widths
from skipnet.training.networks.losses import (
    Similarities,
    contrastive_loss,
    hardest_loss,
    matchability_loss,
)
from skipnet.training.networks.perceptron import PatchNetwork
from skipnet.training.optimizers import ScaledConjugateGradient
from skipnet.training.options import TrainConfig
from skipnet.training.reports import predict
from skipnet.training.schedule import Record, Schedule
from skipnet.training.task import Judgement
from skipnet.training.tasks.classes import head_arrays, train_classifier, with_hidden
from skipnet.training.tasks.descriptor import DescriptorTask, Lessons, StepPlan, draw_pairs
from skipnet.training.trainer import Outcome, Trainer
from skipnet.types import FloatArray

SHORT = Schedule(steps=30, round_steps=10, length="30 steps", rate="warm_cosine")
PLAN = StepPlan(scans=1, pairs_per_scans=64, labelled=32, temperature=0.07)
Step = Callable[[int, float], None]
SMALL = Widths(sector=8, hidden=16, output=8, detail=8, joint=8)
ADAM = partial(torch.optim.AdamW, lr=3e-3)


@pytest.fixture(scope="module")
def patches() -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.exponential(1, (40, SECTORS, SECTOR_SIZE)).astype(np.float32)


@pytest.fixture(scope="module")
def training() -> list[PatchPairs]:
    return make_patch_pairs(["closed"], range(2), per_scans=100)


@pytest.fixture(scope="module")
def labelled() -> Samples:
    how = dataset.Labelling(most_per_class=20, with_surroundings=True)
    return dataset.make_samples(["closed"], range(1), how)


@pytest.fixture(scope="module")
def lessons(training: list[PatchPairs], labelled: Samples) -> Lessons:
    return Lessons(training, labelled, np.ones(len(labelled)))


class Recall(DescriptorTask):
    """Scored by the share of source patches whose nearest target patch is their partner."""

    def judge(self, network: DescriptorNetwork) -> Judgement:
        model, pairs = network.model(), self.lessons.pairs[0]
        found = model.read(pairs.source)[0] @ model.read(pairs.target)[0].T
        return Judgement(float((found.argmax(axis=1) == np.arange(len(pairs))).mean()))


class Scripted(DescriptorTask):
    """Scored as it is told, one round after the other."""

    scores: Sequence[float] = ()
    judged = 0

    def judge(self, network: DescriptorNetwork) -> Judgement:
        self.judged += 1
        return Judgement(self.scores[self.judged - 1])


def train(
    lessons: Lessons,
    schedule: Schedule = SHORT,
    seed: int = 3,
    checkpoint: Path | None = None,
    device: str = "cpu",
    on_step: Step = lambda step, loss: None,
    scores: Sequence[float] | None = None,
) -> Outcome[DescriptorNetwork]:
    """Train a small network, started from the seed."""
    torch.manual_seed(seed)
    network = DescriptorNetwork(SMALL, dropout=0.2)
    task = (Recall if scores is None else Scripted)(lessons, PLAN, [], seed)
    if isinstance(task, Scripted):
        task.scores = scores or ()
    chosen = find_device(device)
    return Trainer(task, network, ADAM, schedule, checkpoint, chosen, on_step).run()


@pytest.fixture(scope="module")
def two_scans() -> TwoScans:
    domes = Recipe(rings_share=0, camera_share=0, fused_share=0, voxel_octaves=0)
    scans = simulate_two_scans("oblique", 20_001, domes)
    assert scans is not None
    return scans


def test_numpy_gives_what_torch_gives(patches: FloatArray) -> None:
    network = DescriptorNetwork(Widths()).eval()
    details = np.random.default_rng(1).random((len(patches), 125)).astype(np.float32)
    network.fit_scaling(torch.from_numpy(patches), torch.from_numpy(details))
    head = PatchNetwork([24, 12], "gelu", beside=Widths().hidden).eval()
    head.fit_scaling(torch.from_numpy(details), "standard")
    with torch.no_grad():
        hidden = network(torch.from_numpy(patches))
        classes = head(torch.cat([torch.from_numpy(details), hidden], dim=1)).softmax(dim=1)
        expected = (*network.recognise(hidden), classes)
    descriptor = SmallNetwork(network.arrays() | head_arrays(head), {})
    found = (*descriptor.read(patches), descriptor.classify(details, patches))
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted.numpy(), atol=2e-5)


def test_the_class_head_reads_cells_and_hidden_units(labelled: Samples, tmp_path: Path) -> None:
    shared = shipped()
    inputs = with_hidden(labelled, shared)
    np.testing.assert_array_equal(inputs.patches[:, :125], labelled.patches)
    np.testing.assert_array_equal(inputs.patches[:, 125:], shared.hidden(labelled.surroundings))
    options = {"_target_": "torch.optim.AdamW", "_partial_": True, "lr": 0.003}
    config = TrainConfig(optimizer=options, epochs=40, batch_size=32)
    notes: list[Record] = []
    outcome = train_classifier(
        config, inputs, inputs, lambda record, judgement: notes.append(record), tmp_path / "a.pt"
    )
    head = head_arrays(outcome.network)
    assert notes == outcome.history[1:]
    assert notes[-1].training_loss < 0.5 * notes[0].training_loss
    learned = SmallNetwork(shared.weights | head, {})
    around = labelled.surroundings
    np.testing.assert_array_equal(learned.read(around)[0], shared.read(around)[0])
    right = predict(learned, labelled) == labelled.labels
    assert right.mean() > 0.9  # of what it learned by heart


def test_waves_give_what_all_cyclic_orders_give(patches: FloatArray) -> None:
    network = DescriptorNetwork(SMALL).eval()
    with torch.no_grad():
        sums = torch.relu(network.sector(torch.from_numpy(patches)))
        orders = [network.mixing(sums.roll(turn, dims=1).flatten(1)) for turn in range(SECTORS)]
        expected = torch.relu(torch.stack(orders).amax(dim=0))
        torch.testing.assert_close(network(torch.from_numpy(patches)), expected)


def test_classes_are_those_of_the_scene() -> None:
    how = dataset.Labelling(most_per_class=40, with_surroundings=True)
    unseen = dataset.make_samples(["paper_room", "closed"], range(3000, 3002), how)
    counts = confusion_matrix(unseen.labels, predict(find_network(), unseen))
    assert macro_f1(counts) > 0.75
    scan = dataset.label_scene("closed", 3001, how, np.random.default_rng(0))[0]
    odds = classify_voxels(scan.skipmap, scan.voxels, find_network())
    np.testing.assert_allclose(odds.sum(axis=1), 1, atol=1e-5)
    assert (odds.argmax(axis=1) == scan.labels).mean() > 0.8


def test_a_turn_about_the_normal_changes_nothing(patches: FloatArray) -> None:
    descriptor = find_network()
    described = descriptor.read(patches)[0]
    np.testing.assert_allclose(np.linalg.norm(described, axis=1), 1, atol=1e-5)
    for turn in range(1, SECTORS):
        turned = descriptor.read(np.roll(patches, turn, axis=1))[0]
        np.testing.assert_allclose(turned, described, atol=1e-5)
    mirrored = descriptor.read(patches[:, ::-1])[0]
    assert np.abs(mirrored - described).max() > 0.1  # but a mirror image is another shape


@pytest.mark.parametrize("sizes", [(700, 1300), (1300, 700), (1, 5), (0, 5)])
def test_mutual_nearest_is_what_all_distances_say(sizes: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    source, target = (rng.normal(size=(size, 8)).astype(np.float32) for size in sizes)
    rows_s, rows_t, distance = mutual_nearest(source, target)
    every = cdist(source, target)
    expected = [
        (s, t)
        for s, t in enumerate(every.argmin(axis=1) if len(source) else [])
        if every[:, t].argmin() == s
    ]
    assert list(zip(rows_s, rows_t, strict=True)) == expected
    np.testing.assert_allclose(distance, every[rows_s, rows_t], atol=1e-5)


def test_wrong_shape_is_refused(patches: FloatArray) -> None:
    with pytest.raises(ValueError, match=r"\(K, 5, 100\), got \(3, 125\)"):
        find_network().read(np.zeros((3, 125), dtype=np.float32))
    with pytest.raises(ValueError, match=r"\(40, 125\), got \(40, 124\)"):
        find_network().classify(np.zeros((40, 124), dtype=np.float32), patches)


def shipped() -> SmallNetwork:
    network = find_network()
    assert isinstance(network, SmallNetwork)
    return network


def test_files(tmp_path: Path, patches: FloatArray) -> None:
    path = tmp_path / "new" / "descriptor.npz"
    with pytest.raises(FileNotFoundError, match="train.py writes one"):
        load_network(path)
    ours = shipped()
    save_network(ours.weights, ours.card, path)
    for again in (load_network(path), find_network(str(path))):
        np.testing.assert_array_equal(again.read(patches)[0], ours.read(patches)[0])
        assert (again.digest, again.card) == (ours.digest, ours.card)
    wrong = {**ours.weights, "extra_weight": np.zeros(1)}
    save_network(wrong, ours.card, tmp_path / "wrong.npz")
    with pytest.raises(ValueError, match="wrong.npz: .*weights .*extra_weight"):
        load_network(tmp_path / "wrong.npz")
    save_network(ours.weights, {**ours.card, "architecture": "wide"}, path)
    with pytest.raises(ValueError, match="architecture is wide, not small"):
        load_network(path)


def test_weights_that_are_not_those_of_their_card_are_refused(tmp_path: Path) -> None:
    path, ours = tmp_path / "network.npz", shipped()
    save_network(ours.weights, ours.card, path)
    first = find_network(str(path))
    assert find_network(str(path)) is first  # read once
    flipped = {**ours.weights, "output_bias": -ours.weights["output_bias"]}
    other = tmp_path / "other.npz"
    save_network(flipped, ours.card, other)
    other.replace(path)
    with pytest.raises(ValueError, match=f"the card says {ours.digest}"):
        find_network(str(path))


def test_a_registration_uses_the_network_it_is_given(tmp_path: Path) -> None:
    path, ours = tmp_path / "network.npz", shipped()
    turned = {**ours.weights, "output_weight": ours.weights["output_weight"][:, ::-1]}
    save_network(turned, ours.card, path)  # the same descriptors in another order
    pair = simulate_pair("oblique", 1, points=20_000).pair
    only = [Generator.descriptors]
    results = [
        register(pair.source_m, pair.target_m, config=RegistrationConfig(only, network=name))
        for name in ("shipped", "small", str(path))
    ]
    digests = [result.details["network"] for result in results]
    assert digests[0] == digests[1] == ours.digest != digests[2] == find_network(str(path)).digest
    np.testing.assert_array_equal(results[0].T_target_source, results[1].T_target_source)
    np.testing.assert_allclose(results[2].T_target_source, results[0].T_target_source, atol=1e-3)
    with pytest.raises(ValueError, match="network=smal: .*did you mean 'small'"):
        RegistrationConfig(network="smal")


@pytest.mark.parametrize("known", [True, False])
def test_correspondences_beat_fpfh_on_an_unseen_scene(two_scans: TwoScans, known: bool) -> None:
    viewpoint_m = np.zeros(3) if known else None
    scans = replace(
        two_scans,
        source=two_scans.source.seen_from(viewpoint_m),
        target=two_scans.target.seen_from(viewpoint_m),
    )
    rows_s, rows_t, distance = correspond(scans.source, scans.target, find_network())
    assert len(np.unique(rows_s)) == len(rows_s) == len(distance)
    found = by_fpfh(scans, keypoints_of(scans, find_network()))
    assert inlier_ratio(scans, rows_s, rows_t) > 1.5 * inlier_ratio(scans, *found)


def test_signs_of_normals_do_not_matter_without_a_viewpoint(two_scans: TwoScans) -> None:
    source, target = two_scans.source.seen_from(None), two_scans.target.seen_from(None)
    normals = source.normals.copy()
    normals[::2] *= -1
    turned = replace(source, normals=normals)
    before, after = (correspond(s, target, find_network(), 500) for s in (source, turned))
    pairs = [
        set(zip(*(rows.tolist() for rows in found[:2]), strict=True)) for found in (before, after)
    ]
    # Opposed normals of both scans leave the same pairs, as seen from the other side.
    assert len(pairs[0] & pairs[1]) > 0.3 * len(pairs[0])


def test_true_correspondences_lie_at_one_place(two_scans: TwoScans) -> None:
    rows_s, rows_t, agree = true_correspondences(two_scans)
    assert len(rows_s) > 500 and (agree == 1).all()
    assert inlier_ratio(two_scans, rows_s, rows_t) == 1.0
    assert inlier_ratio(two_scans, rows_s, np.roll(rows_t, len(rows_t) // 2)) < 0.05
    assert inlier_ratio(two_scans, rows_s[:0], rows_t[:0]) == 0.0


def test_equal_responses_share_the_gradient_of_the_strongest() -> None:
    responses = torch.tensor([[1.0, 2.0], [3.0, 2.0], [3.0, 0.0]]).requires_grad_()
    for strongest in (Strongest.apply(responses), responses.amax(dim=0)):
        (gradient,) = torch.autograd.grad(strongest, responses, torch.tensor([1.0, 3.0]))
        expected = torch.tensor([[0.0, 1.5], [0.5, 1.5], [0.5, 0.0]])
        torch.testing.assert_close(gradient, expected, rtol=0, atol=0)


def alike(far: torch.Tensor, descriptors: torch.Tensor | None = None) -> Similarities:
    """Two places, descriptors at right angles unless given, the same in both scans."""
    both = torch.eye(2) if descriptors is None else descriptors
    return Similarities.of(both, both, far, temperature=1.0)


APART = ~torch.eye(2, dtype=torch.bool)


def test_contrastive_loss_by_hand() -> None:
    # Per row the partner scores 1, the other place 0 twice (in the other scan and in its own):
    # -log(e / (e + 2)).
    expected = -np.log(np.e / (np.e + 2))
    assert contrastive_loss(alike(APART)).item() == pytest.approx(expected, abs=1e-6)
    nothing_far = torch.zeros(2, 2, dtype=torch.bool)
    assert contrastive_loss(alike(nothing_far)).item() == pytest.approx(0, abs=1e-6)


def test_hardest_loss_by_hand() -> None:
    # The partner leads by 1.
    assert hardest_loss(alike(APART), margin=1.5).item() == pytest.approx(0.5)
    assert hardest_loss(alike(APART), margin=0.5).item() == 0.0


def test_matchability_loss_asks_for_what_was_found() -> None:
    found, confused = alike(APART), alike(APART, torch.tensor([[1.0, 0], [1, 0]]))
    sure = torch.full((2,), 20.0)
    assert matchability_loss(sure, sure, found).item() < 1e-6
    assert matchability_loss(-sure, -sure, found).item() == pytest.approx(20)
    assert matchability_loss(sure, sure, confused).item() == pytest.approx(10)  # one of two


def test_near_places_are_no_negatives(training: list[PatchPairs]) -> None:
    two = replace(PLAN, scans=2)
    source, target, far = draw_pairs(training, two, np.random.default_rng(0))
    assert source.shape == target.shape == (128, SECTORS, SECTOR_SIZE)
    assert not far.diagonal().any() and (far == far.T).all()
    assert far[:64, 64:].all() and not far[:64, :64].all()  # other scans are always other places


def assert_same_weights(
    first: Outcome[DescriptorNetwork], second: Outcome[DescriptorNetwork]
) -> None:
    again = second.network.arrays()
    for name, weight in first.network.arrays().items():
        np.testing.assert_array_equal(weight, again[name])


def test_data_and_training_repeat_from_the_seed_and_learn(lessons: Lessons) -> None:
    again = make_patch_pairs(["closed"], range(2), per_scans=100)
    assert digest(lessons.pairs) == digest(again) != digest(again[:1])
    losses: list[float] = []
    first, second = (
        train(data, on_step=lambda step, loss: losses.append(loss))
        for data in (lessons, replace(lessons, pairs=again))
    )
    assert_same_weights(first, second)
    assert np.mean(losses[25:30]) < 0.8 * np.mean(losses[:5])
    assert first.stop_reason == "all 30 steps done"
    assert [record.step for record in first.history] == [10, 20, 30]
    assert first.history[0].training_loss == pytest.approx(np.mean(losses[:10]))


@pytest.mark.parametrize("killed_at", [7, 10, 25])
def test_a_killed_training_resumed_gives_the_same_weights(
    lessons: Lessons, tmp_path: Path, killed_at: int
) -> None:
    checkpoint = tmp_path / "checkpoint.pt"
    whole = train(lessons)

    def kill(step: int, loss: float) -> None:
        if step == killed_at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(lessons, checkpoint=checkpoint, on_step=kill)
    steps: list[int] = []
    resumed = train(lessons, checkpoint=checkpoint, on_step=lambda step, loss: steps.append(step))
    assert len(steps) == 30 - (killed_at - 1) // 10 * 10
    assert_same_weights(whole, resumed)
    assert (resumed.best, resumed.history) == (whole.best, whole.history)
    with pytest.raises(ValueError, match="another output_dir"):
        train(lessons, seed=4, checkpoint=checkpoint)


def test_training_stops_early_and_keeps_the_best(lessons: Lessons) -> None:
    long = replace(SHORT, steps=50, length="50 steps")
    patient = replace(long, max_fail=2)
    outcome = train(lessons, patient, scores=[0.1, 0.5, 0.4, 0.3, 0.9])
    assert outcome.stop_reason == "2 validations below the best one"
    assert (outcome.best.step, outcome.best.score) == (20, 0.5)
    assert_same_weights(outcome, train(lessons, long, scores=[0, 1, 0, 0, 0]))
    assert train(lessons, patient, scores=[0.5] * 5).stop_reason == "all 50 steps done"


def test_what_a_training_cannot_use_is_refused(lessons: Lessons) -> None:
    with pytest.raises(ValueError, match="a step takes 1 pairs of scans"):
        train(replace(lessons, pairs=[]))
    network = DescriptorNetwork(SMALL).double()
    task = Recall(lessons, PLAN, [], 0)
    with pytest.raises(ValueError, match="all samples at once"):
        Trainer(task, network, ScaledConjugateGradient, SHORT)


def present(name: str) -> bool:
    """Whether torch finds the device here."""
    try:
        find_device(name)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("name", ["cpu", "cuda", "mps"])
def test_every_device_learns_the_same(lessons: Lessons, name: str) -> None:
    if not present(name):
        with pytest.raises(ValueError, match=f"device={name}: torch .* expected cpu"):
            train(lessons, device=name)
        return
    short = replace(
        SHORT, steps=3, round_steps=3
    )  # dropout differs between devices: leave no time to diverge
    here, there = (train(lessons, short, device=where) for where in ("cpu", name))
    for key, weight in here.network.arrays().items():
        np.testing.assert_allclose(there.network.arrays()[key], weight, atol=0.02)


@pytest.mark.parametrize("family", ["terrain", "clutter"])
def test_scans_are_spoilt_as_the_recipe_says(family: str) -> None:
    gentle = Recipe(0, 0, 0, voxel_octaves=0, noise_voxels=[0.0], least_kept=1.0, holes=0)
    harsh = replace(gentle, least_kept=0.01, holes=6)
    whole, torn = (simulate_two_scans(family, 3, how) for how in (gentle, harsh))
    assert whole is not None and torn is not None
    assert whole.oriented and not np.allclose(whole.T_target_source, np.eye(4))
    assert torn.source.counts.sum() < 0.9 * whole.source.counts.sum()
    fused = simulate_two_scans(family, 3, replace(gentle, fused_share=1.0))
    assert fused is not None and not fused.oriented and fused.source.viewpoint_m is None


def test_scores_by_hand() -> None:
    matches = [Match(0.5, 0.95, 1.0), Match(0.04, 0.15, 3.0), Match(0.06, 0.12, 2.0)]
    scores = summarise(matches)
    assert scores == pytest.approx(
        {"inlier_ratio": 0.2, "matched_pairs": 2 / 3, "seconds": 2.0, "pairs": 3}
    )
    groups = by_overlap(matches)
    assert list(groups) == ["10% to 20%", "50% to 100%"]
    assert groups["10% to 20%"]["matched_pairs"] == 0.5


def test_the_most_matchable_keypoints_are_kept(two_scans: TwoScans) -> None:
    descriptor, scan = find_network(), two_scans.source
    rows = choose_keypoints(scan, 500)
    described, matchable = descriptor.read(cylinder_patches(scan, rows))
    kept, kept_described = describe_keypoints(scan, descriptor, max_keypoints=500)
    assert len(kept) == 300
    inside = np.isin(rows, kept)
    assert matchable[inside].min() >= matchable[~inside].max()
    order = np.searchsorted(rows, kept)
    np.testing.assert_allclose(kept_described, described[order], atol=1e-5)
    both, _ = describe_keypoints(scan, descriptor, both_sides=True, max_keypoints=500)
    assert len(both) == 600 and np.unique(both, return_counts=True)[1].max() == 2


def test_matchable_keypoints_are_found_more_often(two_scans: TwoScans) -> None:
    descriptor = find_network()
    rows_s, rows_t, _ = correspond(two_scans.source, two_scans.target, descriptor)
    of_all = Keypoints.of(two_scans, descriptor).inlier_ratio(descriptor)
    assert inlier_ratio(two_scans, rows_s, rows_t) > of_all > 0


def test_other_weights_enter_a_benchmark_beside_the_shipped_ones(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="weights="):
        EvaluateConfig(weights=str(tmp_path / "absent.npz"))
    path = tmp_path / "other.npz"
    save_network(shipped().weights, {"architecture": "small"}, path)
    config = EvaluateConfig(weights=str(path))
    assert list(config.methods) == ["learned_sc2", "other_weights"]
    pair = simulate_pair("clutter", 1, points=40_000).pair
    task = Task(pair.source_m, pair.target_m, np.zeros(3), np.zeros(3))
    answers = []
    for method in config.methods.values():
        answers.append(make_method(method.make, dict(method.options))(task))
    assert answers[0].correspondences is not None
    np.testing.assert_array_equal(answers[0].correspondences, answers[1].correspondences)


READS = """
import json, sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
from skipnet.training.data.pairs import make_patch_pairs
pairs = make_patch_pairs(["facade", "curved"], range(2), per_scans=20)
reader = "skipnet.clouds.formats.reading" in sys.modules
json.dump({"pairs": len(pairs), "opened": opened, "reader": reader}, sys.stdout)
"""


def test_training_data_come_from_no_file() -> None:
    run = subprocess.run([sys.executable, "-c", READS], capture_output=True, text=True, check=True)
    seen = json.loads(run.stdout)
    assert seen["pairs"] == 2 and seen["opened"]
    assert not seen["reader"], "training imported the reader of point files"
    # numba asks what is installed whether it extends numba.
    opened = [name for name in seen["opened"] if Path(name).name != "entry_points.txt"]
    clouds = [name for name in opened if Path(name).suffix.lower() in _READERS]
    assert not clouds, f"training opened {clouds}"


def test_train_py_writes_a_network_that_loads(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    counts = {"training_pairs": 2, "validation_pairs": 1, "test_pairs": 2, "patches_per_scans": 100}
    counts |= {"patches_per_step": 128, "steps": 20, "validate_every": 10}
    options = [f"descriptor.{name}={count}" for name, count in counts.items()]
    scenes = {"training_scenes": 1, "validation_scenes": 1, "test_scenes": 1, "most_per_class": 20}
    options += [f"data.{name}={count}" for name, count in (scenes | {"workers": 1}).items()]
    options += ["descriptor.families=[closed]", "data.families=[closed]", "epochs=1"]
    script = Path(__file__).parents[2] / "train.py"
    run = subprocess.run(
        [sys.executable, str(script), "compare_alone=true", f"output_dir={tmp_path}", *options],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert "| fpfh | all | 2 |" in run.stdout and "| classes alone | all |" in run.stdout
    summary = json.loads((tmp_path / "summary.json").read_text())
    card = load_network(tmp_path / "descriptor.npz").card
    assert set(card) == set(find_network().card)
    assert set(card["config"]) == set(find_network().card["config"])
    assert card["scores"]["learned"] == summary["unseen"]["learned"]["all"]
    assert card["scores"]["learned"]["pairs"] == 2
    both, alone = (summary["classes"][name]["all"] for name in ("both heads", "classes alone"))
    assert card["scores"]["classes"]["both heads"] == both
    assert both["voxels"] == alone["voxels"] > 1000
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    for scalar in ("inlier_ratio", "matched_pairs"):
        assert len(events.Scalars(f"{scalar}/validation")) == 2, scalar
    assert events.Scalars("classes/macro_f1/validation")
    assert list((tmp_path / "tensorboard").rglob("metadata.tsv"))
    for name in ("learned inlier_ratio", "both heads macro_f1", "classes alone macro_f1"):
        assert len(events.Scalars(f"hparam/{name}")) == 1, name
    assert "_hparams_/session_start_info" in events.summary_metadata
    assert "skipmap/network_class_VERTEX" in events.Tags()["tensors"]


def test_the_shipped_card_says_where_the_weights_come_from() -> None:
    card = find_network().card
    assert card["training_data"]["origin"].startswith("simulation only")
    assert card["config"]["descriptor"]["families"] and card["config"]["data"]["families"]
    assert "output_dir" not in card["config"]
    assert card["scores"]["learned"]["pairs"] > 0
    both, alone = (card["scores"]["classes"][name] for name in ("both heads", "classes alone"))
    assert both["voxels"] == alone["voxels"]
    assert both["macro_f1"] > alone["macro_f1"]  # the class head loses nothing
    assert SHIPPED_WEIGHTS.stat().st_size < 200_000
