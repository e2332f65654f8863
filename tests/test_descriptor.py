"""The learned descriptor: NumPy against torch, invariances, training from simulation alone."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.distance import cdist

from skipnet.clouds.formats import _READERS
from skipnet.features.cylinders import SECTOR_SIZE, SECTORS, choose_keypoints
from skipnet.features.descriptors import fpfh, mutual_nearest
from skipnet.learning.descriptor import (
    Descriptor,
    correspond,
    load_descriptor,
    save_descriptor,
)
from skipnet.learning.descriptor_experiment import inlier_ratio, recognised
from skipnet.learning.descriptor_pairs import (
    PatchPairs,
    TwoScans,
    digest,
    make_patch_pairs,
    simulate_two_scans,
    true_correspondences,
)
from skipnet.learning.descriptor_training import (
    DescriptorNetwork,
    Schedule,
    Widths,
    contrastive_loss,
    draw_batch,
    train_network,
)
from skipnet.types import FloatArray

SHORT = Schedule(
    steps=30, scans_per_step=1, pairs_per_scans=64, learning_rate=2e-3, temperature=0.07
)
SMALL = Widths(hidden=16, output=8)


@pytest.fixture(scope="module")
def patches() -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.exponential(1, (40, SECTORS, SECTOR_SIZE)).astype(np.float32)


@pytest.fixture(scope="module")
def training() -> list[PatchPairs]:
    return make_patch_pairs(["closed"], range(2), per_scans=100)


@pytest.fixture(scope="module")
def two_scans() -> TwoScans:
    scans = simulate_two_scans("oblique", 20_001)
    assert scans is not None
    return scans


def test_numpy_gives_what_torch_gives(patches: FloatArray) -> None:
    network = DescriptorNetwork(Widths())
    network.fit_scaling(torch.from_numpy(patches))
    with torch.no_grad():
        expected = network(torch.from_numpy(patches)).numpy()
    np.testing.assert_allclose(Descriptor(network.arrays(), {})(patches), expected, atol=2e-5)


def test_a_turn_about_the_normal_changes_nothing(patches: FloatArray) -> None:
    descriptor = load_descriptor()
    described = descriptor(patches)
    np.testing.assert_allclose(np.linalg.norm(described, axis=1), 1, atol=1e-5)
    for turn in range(1, SECTORS):
        turned = descriptor(np.roll(patches, turn, axis=1))
        np.testing.assert_allclose(turned, described, atol=1e-5)
    mirrored = descriptor(patches[:, ::-1])
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


def test_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(K, 5, 75\), got \(3, 125\)"):
        load_descriptor()(np.zeros((3, 125), dtype=np.float32))


def test_files(tmp_path: Path, patches: FloatArray) -> None:
    path = tmp_path / "new" / "descriptor.npz"
    with pytest.raises(FileNotFoundError, match="experiment=descriptor"):
        load_descriptor(path)
    shipped = load_descriptor()
    save_descriptor(shipped, path)
    np.testing.assert_array_equal(load_descriptor(path)(patches), shipped(patches))
    wrong = {**shipped.weights, "extra_weight": np.zeros(1)}
    save_descriptor(Descriptor(wrong, {}), tmp_path / "wrong.npz")
    with pytest.raises(ValueError, match="extra_weight"):
        load_descriptor(tmp_path / "wrong.npz")


@pytest.mark.parametrize("known", [True, False])
def test_correspondences_beat_fpfh_on_an_unseen_scene(two_scans: TwoScans, known: bool) -> None:
    viewpoint_m = np.zeros(3) if known else None
    scans = replace(
        two_scans,
        source=two_scans.source.seen_from(viewpoint_m),
        target=two_scans.target.seen_from(viewpoint_m),
    )
    rows_s, rows_t, distance = correspond(scans.source, scans.target, load_descriptor(), 3000)
    assert len(np.unique(rows_s)) == len(rows_s) == len(distance)
    keypoints = [choose_keypoints(scan, 3000) for scan in (scans.source, scans.target)]
    of_s, of_t, _ = mutual_nearest(
        fpfh(scans.source)[keypoints[0]], fpfh(scans.target)[keypoints[1]]
    )
    by_fpfh = inlier_ratio(scans, keypoints[0][of_s], keypoints[1][of_t])
    assert inlier_ratio(scans, rows_s, rows_t) > 1.5 * by_fpfh


def test_signs_of_normals_do_not_matter_without_a_viewpoint(two_scans: TwoScans) -> None:
    source, target = two_scans.source.seen_from(None), two_scans.target.seen_from(None)
    axes = source.axes.copy()
    axes[::2, :, 0] *= -1
    turned = replace(source, axes=axes)
    before, after = (correspond(s, target, load_descriptor(), 500) for s in (source, turned))
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


def test_loss_by_hand() -> None:
    # Two places, descriptors at right angles, temperature 1: per row the partner scores 1, the
    # other place 0 twice (in the other scan and in its own): -log(e / (e + 2)).
    both = torch.eye(2)
    far = ~torch.eye(2, dtype=torch.bool)
    expected = -np.log(np.e / (np.e + 2))
    assert contrastive_loss(both, both, far, 1.0).item() == pytest.approx(expected, abs=1e-6)
    nothing_far = torch.zeros(2, 2, dtype=torch.bool)
    assert contrastive_loss(both, both, nothing_far, 1.0).item() == pytest.approx(0, abs=1e-6)


def test_near_places_are_no_negatives(training: list[PatchPairs]) -> None:
    two = replace(SHORT, scans_per_step=2)
    source, target, far = draw_batch(training, two, np.random.default_rng(0))
    assert source.shape == target.shape == (128, SECTORS, SECTOR_SIZE)
    assert not far.diagonal().any() and (far == far.T).all()
    assert far[:64, 64:].all() and not far[:64, :64].all()  # other scans are always other places


def test_data_and_training_repeat_from_the_seed_and_learn(training: list[PatchPairs]) -> None:
    again = make_patch_pairs(["closed"], range(2), per_scans=100)
    assert digest(training) == digest(again) != digest(training[:1])
    losses: list[float] = []
    first, second = (
        train_network(data, SMALL, SHORT, 3, lambda step, loss, network: losses.append(loss))
        for data in (training, again)
    )
    for name, weight in first.arrays().items():
        np.testing.assert_array_equal(weight, second.arrays()[name])
    assert np.mean(losses[25:30]) < 0.8 * np.mean(losses[:5])
    untrained = DescriptorNetwork(SMALL)
    assert recognised(first, training[0]) > recognised(untrained, training[0])


def test_too_few_scans_for_a_step() -> None:
    with pytest.raises(ValueError, match="a step takes 1 pairs of scans"):
        train_network([], SMALL, SHORT, 0, lambda step, loss, network: None)


READS = """
import json, sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
from skipnet.learning.descriptor_pairs import make_patch_pairs
pairs = make_patch_pairs(["facade", "curved"], range(2), per_scans=20)
reader = "skipnet.clouds.formats" in sys.modules
json.dump({"pairs": len(pairs), "opened": opened, "reader": reader}, sys.stdout)
"""


def test_training_data_come_from_no_file() -> None:
    run = subprocess.run([sys.executable, "-c", READS], capture_output=True, text=True, check=True)
    seen = json.loads(run.stdout)
    assert seen["pairs"] == 2 and seen["opened"]
    assert not seen["reader"], "training imported the reader of point files"
    clouds = [name for name in seen["opened"] if Path(name).suffix.lower() in _READERS]
    assert not clouds, f"training opened {clouds}"


def test_train_py_writes_a_descriptor_that_loads(tmp_path: Path) -> None:
    options = ["families=[closed]", "training_pairs=2", "validation_pairs=1", "test_pairs=2"]
    options += ["patches_per_scans=100", "patches_per_step=128", "steps=20", "workers=1"]
    script = Path(__file__).parents[1] / "train.py"
    run = subprocess.run(
        [sys.executable, str(script), "experiment=descriptor", f"output_dir={tmp_path}"]
        + [f"descriptor.{option}" for option in options],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert "| fpfh | 2 |" in run.stdout
    summary = json.loads((tmp_path / "summary.json").read_text())
    card = load_descriptor(tmp_path / "descriptor.npz").card
    assert card["scores"] == summary["unseen"] and summary["unseen"]["learned"]["pairs"] == 2
    assert list((tmp_path / "tensorboard").iterdir())


def test_the_shipped_card_says_so() -> None:
    card = load_descriptor().card
    assert card["training_data"]["origin"].startswith("simulation only")
    assert set(card["config"]["families"]) and card["scores"]["learned"]["pairs"] > 0
