"""The network, its training and its scores against PyTorch, scikit-learn and hand-worked cases."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import torch

from skipnet.metrics.classes import confusion_matrix, f1_per_class, macro_f1
from skipnet.parallel.pools import mapping
from skipnet.training.data.labelled import Labelling, Samples, make_samples, thin
from skipnet.training.experiments.class_samples import draw_evenly, split_at_random
from skipnet.training.experiments.peers import predict_with_peers
from skipnet.training.networks.perceptron import (
    Classifier,
    PatchNetwork,
    classify,
    load_classifier,
    round_to_half,
    save_classifier,
)
from skipnet.training.optimizers import OptimizerFactory, ScaledConjugateGradient
from skipnet.training.schedule import Record, Schedule
from skipnet.training.scores import score
from skipnet.training.task import Judgement
from skipnet.training.tasks.classes import ClassTask, TrainingSet, matlab_cross_entropy
from skipnet.training.trainer import Outcome, Trainer

OPTIMIZERS = {
    "adam": (partial(torch.optim.Adam, lr=0.01), torch.float32),
    "adamw": (partial(torch.optim.AdamW, lr=0.01), torch.float32),
    "sgd": (partial(torch.optim.SGD, lr=1.0, momentum=0.9), torch.float32),
    "rmsprop": (partial(torch.optim.RMSprop, lr=0.003), torch.float32),
    "lbfgs": (
        partial(torch.optim.LBFGS, lr=1.0, max_iter=4, line_search_fn="strong_wolfe"),
        torch.float64,
    ),
    "scg": (ScaledConjugateGradient, torch.float64),
}


def blobs(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Five clouds in 125 dimensions that a line cannot all tell apart, but a network can."""
    centres = np.random.default_rng(0).normal(size=(5, 125))
    rng = np.random.default_rng(seed)
    labels = rng.integers(5, size=count)
    side = np.where(rng.random(count) < 0.5, 1, -1)
    patches = side[:, None] * centres[labels] + 0.5 * rng.normal(size=(count, 125))
    return patches.astype(np.float32), labels


def fit(
    network: PatchNetwork,
    training: TrainingSet,
    validation: TrainingSet,
    make_optimizer: OptimizerFactory,
    epochs: int = 1000,
    rules: Mapping[str, float] = MappingProxyType({}),
    batch_size: int | None = None,
    rate: str = "constant",
    seed: int = 0,
    checkpoint: Path | None = None,
    on_round: Callable[[Record, Judgement], None] = lambda record, judgement: None,
) -> Outcome[PatchNetwork]:
    """Fit a network for the classes; rules are those of ``Schedule``."""
    task = ClassTask(training, validation, batch_size, seed=seed)
    steps = task.steps_per_pass
    schedule = Schedule(epochs * steps, steps, f"{epochs} epochs", rate, **rules)
    return Trainer(task, network, make_optimizer, schedule, checkpoint, on_round=on_round).run()


def samples_of(patches: np.ndarray, labels: np.ndarray) -> Samples:
    count = len(labels)
    return Samples(
        patches,
        np.zeros((count, 5, 0), dtype=np.float16),
        labels,
        weights=np.ones(count),
        ranges_m=np.linspace(0.5, 9.5, count),
        scenes=np.arange(count),
        families=np.arange(count) % 2,
    )


# --- network --------------------------------------------------------------------------------------


def test_network_is_the_formula_of_the_paper() -> None:
    torch.manual_seed(1)
    network = PatchNetwork([50])
    patches = torch.rand(7, 125) * 3
    network.fit_scaling(patches)
    low, high = patches.amin(0), patches.amax(0)
    scaled = 2 * (patches - low) / (high - low) - 1  # mapminmax
    first, last = (m for m in network.layers if isinstance(m, torch.nn.Linear))
    tansig = 2 / (1 + torch.exp(-2 * (scaled @ first.weight.T + first.bias))) - 1
    expected = torch.softmax(tansig @ last.weight.T + last.bias, dim=1)
    got = classify(Classifier(network.eval(), {}), patches.numpy())
    np.testing.assert_allclose(got, expected.detach().numpy(), atol=1e-6)
    np.testing.assert_allclose(got.sum(axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("scaling", ["minmax", "standard"])
def test_an_input_that_never_changed_is_left_out(scaling: str) -> None:
    torch.manual_seed(0)
    network = PatchNetwork([8])
    patches = torch.rand(20, 125)
    patches[:, 3] = 0.7
    network.fit_scaling(patches, scaling)
    other = patches.clone()
    other[:, 3] = 99.0
    torch.testing.assert_close(network(patches), network(other))


def test_weights_come_back_as_they_were_saved(tmp_path: Path) -> None:
    torch.manual_seed(2)
    network = round_to_half(PatchNetwork([16, 8], "gelu").eval())
    card = {"hidden_sizes": [16, 8], "activation": "gelu", "patch": "surface_frame"}
    save_classifier(Classifier(network, card), tmp_path / "a" / "weights.pt")
    loaded = load_classifier(tmp_path / "a" / "weights.pt")
    patches = np.random.default_rng(0).random((9, 125))
    np.testing.assert_array_equal(
        classify(loaded, patches), classify(Classifier(network, card), patches)
    )
    assert loaded.card == card


def test_weights_that_do_not_fit_their_card_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pt"
    card = {"hidden_sizes": [4], "activation": "tanh"}
    save_classifier(Classifier(PatchNetwork([4]), card), path)
    path.with_suffix(".json").write_text(json.dumps({**card, "hidden_sizes": [5]}))
    with pytest.raises(ValueError, match="does not fit"):
        load_classifier(path)
    with pytest.raises(FileNotFoundError, match="train.py"):
        load_classifier(tmp_path / "absent.pt")


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (lambda: PatchNetwork([]), "hidden_sizes"),
        (lambda: PatchNetwork([5], "relu6"), "tanh or gelu"),
        (lambda: PatchNetwork([5]).fit_scaling(torch.rand(3, 125), "log"), "minmax or standard"),
        (lambda: classify(Classifier(PatchNetwork(), {}), np.zeros((3, 124))), r"\(K, 125\)"),
        (lambda: TrainingSet(np.zeros((3, 125)), np.zeros(2)).tensors(torch.float32), "2 labels"),
    ],
)
def test_bad_input_says_what_is_wrong(action, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        action()


# --- training -------------------------------------------------------------------------------------


def test_cross_entropy_is_averaged_over_outputs_and_samples_as_in_matlab() -> None:
    logits = torch.tensor([[2.0, 0, 0, 0, 0], [0, 1.0, 0, 0, 3.0]])
    labels = torch.tensor([0, 1])
    probability = torch.softmax(logits, dim=1)
    by_hand = -(torch.log(probability[0, 0]) + torch.log(probability[1, 1])) / (2 * 5)
    torch.testing.assert_close(matlab_cross_entropy(logits, labels), by_hand)


@pytest.mark.parametrize("name", list(OPTIMIZERS))
def test_every_optimiser_learns(name: str) -> None:
    make_optimizer, dtype = OPTIMIZERS[name]
    torch.manual_seed(0)
    network = PatchNetwork([20]).to(dtype)
    training, validation = TrainingSet(*blobs(400, 1)), TrainingSet(*blobs(200, 2))
    outcome = fit(network, training, validation, make_optimizer, epochs=80)
    predicted = classify(Classifier(network.float(), {}), validation.patches).argmax(axis=1)
    assert np.mean(predicted == validation.labels) > 0.9
    scores = [record.score for record in outcome.history]
    assert outcome.best.round == int(np.argmax(scores))


def test_the_network_ends_with_the_best_validation_weights() -> None:
    torch.manual_seed(0)
    network = PatchNetwork([30])
    validation = TrainingSet(*blobs(100, 2))
    make = partial(torch.optim.Adam, lr=0.05)
    outcome = fit(network, TrainingSet(*blobs(40, 1)), validation, make, epochs=60)
    patches, labels, _ = validation.tensors(torch.float32)
    now = float(matlab_cross_entropy(network(patches), labels).detach())
    assert now == pytest.approx(min(-record.score for record in outcome.history))


@pytest.mark.parametrize(
    ("rules", "learnable", "reason"),
    [
        ({}, True, "all 200 epochs done"),
        ({"goal": 0.05}, True, "goal 0.05 reached"),
        ({"min_gradient": 10.0}, True, "gradient below 10"),
        ({"max_fail": 6}, False, "6 validations below the best one"),
    ],
)
def test_each_stopping_rule_stops_and_is_named(
    rules: Mapping[str, float], learnable: bool, reason: str
) -> None:
    torch.manual_seed(0)
    patches, labels = blobs(40, 1)
    noise = np.random.default_rng(3).integers(5, size=40)
    learned = TrainingSet(patches, labels)
    watched = TrainingSet(patches, labels if learnable else noise)
    network = PatchNetwork([20]).double()
    outcome = fit(network, learned, watched, ScaledConjugateGradient, 200, rules)
    assert outcome.stop_reason.startswith(reason)


def test_training_repeats_bit_by_bit() -> None:
    def train(seed: int) -> np.ndarray:
        torch.manual_seed(seed)
        network = PatchNetwork([16], dropout=0.2)
        fit(
            network,
            TrainingSet(*blobs(300, 1)),
            TrainingSet(*blobs(100, 2)),
            partial(torch.optim.AdamW, lr=0.01),
            epochs=4,
            batch_size=32,
            rate="cosine",
            seed=seed,
        )
        return classify(Classifier(network, {}), blobs(20, 3)[0])

    np.testing.assert_array_equal(train(0), train(0))
    assert not np.array_equal(train(0), train(1))


@pytest.mark.parametrize("optimizer", ["adamw", "scg"])
def test_a_killed_training_resumed_gives_the_same_weights(optimizer: str, tmp_path: Path) -> None:
    patches, labels = blobs(300, 0)
    learned, watched = TrainingSet(patches, labels), TrainingSet(patches[:60], labels[:60])
    whole_set = optimizer == "scg"
    make = ScaledConjugateGradient if whole_set else partial(torch.optim.AdamW, lr=0.01)

    def train(
        epochs: int, checkpoint: Path | None = None, killed_at: int = -1
    ) -> Outcome[PatchNetwork]:
        """A fitted network; stopped in the middle, before the epoch of that number is written."""

        def kill(record: Record, judgement: Judgement) -> None:
            if record.round == killed_at:
                raise KeyboardInterrupt

        torch.manual_seed(0)
        network = PatchNetwork([8], dropout=0.2).double()
        rules, batch = {"max_fail": 6}, None if whole_set else 64
        return fit(
            network, learned, watched, make, epochs, rules, batch, "cosine", 0, checkpoint, kill
        )

    checkpoint = tmp_path / "checkpoint.pt"
    whole = train(8)
    with pytest.raises(KeyboardInterrupt):
        train(8, checkpoint, killed_at=5)
    torch.manual_seed(99)  # whatever was drawn before, the checkpoint sets it right
    resumed = train(8, checkpoint)
    assert resumed.history == whole.history and len(whole.history) == 9
    for name, weight in whole.network.state_dict().items():
        assert torch.equal(weight, resumed.network.state_dict()[name]), name
    with pytest.raises(ValueError, match="another output_dir"):
        train(9, checkpoint)


def test_weights_count_as_repeated_samples() -> None:
    logits, labels = torch.rand(3, 5), torch.tensor([0, 3, 4])
    _, _, weights = TrainingSet(np.zeros((3, 125)), labels.numpy(), np.array([1.0, 2, 3])).tensors(
        torch.float32
    )
    rows = torch.tensor([0, 1, 1, 2, 2, 2])
    torch.testing.assert_close(
        matlab_cross_entropy(logits, labels, weights),
        matlab_cross_entropy(logits[rows], labels[rows]),
    )


def test_conjugate_gradient_refuses_mini_batches() -> None:
    with pytest.raises(ValueError, match="batch_size=null"):
        sets = TrainingSet(*blobs(20, 0)), TrainingSet(*blobs(20, 1))
        fit(PatchNetwork([4]).double(), *sets, ScaledConjugateGradient, batch_size=10)


# --- scores and data ------------------------------------------------------------------------------


def test_scores_agree_with_scikit_learn() -> None:
    from sklearn.metrics import confusion_matrix as reference_matrix
    from sklearn.metrics import f1_score

    rng = np.random.default_rng(0)
    labels, predicted = rng.integers(5, size=500), rng.integers(5, size=500)
    counts = confusion_matrix(labels, predicted)
    np.testing.assert_array_equal(counts, reference_matrix(labels, predicted))
    np.testing.assert_allclose(f1_per_class(counts), f1_score(labels, predicted, average=None))
    assert macro_f1(counts) == pytest.approx(f1_score(labels, predicted, average="macro"))


def test_scores_by_range_and_family_cover_every_voxel_once() -> None:
    patches, labels = blobs(300, 0)
    samples = samples_of(patches, labels)
    table = score(samples, labels, ["a", "b"])
    assert table["all"]["macro_f1"] == 1.0
    for kind in ("range", "family"):
        assert sum(row["voxels"] for name, row in table.items() if name.startswith(kind)) == 300


def test_peers_learn_what_the_network_learns() -> None:
    training, (patches, labels) = samples_of(*blobs(250, 1)), blobs(200, 2)
    predicted, seconds = predict_with_peers(training, training.weights, patches, seed=0)
    assert set(predicted) == {"RandomForest", "SVC", "kNN", "HistGradientBoosting"} == set(seconds)
    for name, classes in predicted.items():
        assert np.mean(classes == labels) > 0.6, name


def test_thinning_keeps_at_most_so_many_and_remembers_how_many_there_were() -> None:
    labels = np.repeat([0, 3, 4], [2, 50, 7])
    rows, weights = thin(labels, 5, np.random.default_rng(0))
    np.testing.assert_array_equal(np.bincount(labels[rows]), [2, 0, 0, 5, 5])
    np.testing.assert_allclose(np.bincount(labels[rows], weights=weights), [2, 0, 0, 50, 7])


def test_random_split_is_disjoint_whole_and_of_matlabs_sizes() -> None:
    parts = split_at_random(510, (0.7, 0.15, 0.15), np.random.default_rng(0))
    assert [len(part) for part in parts] == [357, 77, 76]
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(510))


def test_even_draws_are_even_or_refused() -> None:
    patches, labels = blobs(400, 0)
    drawn = draw_evenly(samples_of(patches, labels), 100, np.random.default_rng(0))
    np.testing.assert_array_equal(np.bincount(drawn.labels), [20] * 5)
    with pytest.raises(ValueError, match="training_scenes"):
        draw_evenly(samples_of(patches, labels), 1000, np.random.default_rng(0))


def test_data_do_not_depend_on_the_number_of_workers() -> None:
    labelling = Labelling(most_per_class=20)
    alone = make_samples(["closed", "paper_room"], [3, 4], labelling)
    with mapping(2) as each:
        together = make_samples(["closed", "paper_room"], [3, 4], labelling, each)
    assert alone.digest() == together.digest()
    np.testing.assert_array_equal(np.unique(alone.scenes), [3, 4])
    assert (np.bincount(alone.labels, minlength=5) > 0).sum() >= 4
    with pytest.raises(ValueError, match="at least one"):
        make_samples([], [1], labelling)
