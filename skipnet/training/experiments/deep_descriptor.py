"""The deep network: fed by the factory as it learns, judged on numbers it never saw."""

from __future__ import annotations

import json
import time
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import torch

from skipnet.metrics.correspondences import Keypoints, TwoScans
from skipnet.networks.catalog import find_network, load_network, save_network
from skipnet.networks.deep import DeepNetwork
from skipnet.networks.devices import find_device
from skipnet.networks.model import Model
from skipnet.networks.names import DEEP_WEIGHTS
from skipnet.networks.torch_network import TorchNetwork
from skipnet.progress import counted
from skipnet.simulation.seeds import DEEP_TEST, DEEP_TRAINING, DEEP_VALIDATION
from skipnet.storage import write_config, write_text
from skipnet.training import reports
from skipnet.training.data.factory import KINDS, PatchFactory, make_pairs, make_scans, working
from skipnet.training.experiments.both_heads import CHECKPOINT, reached
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.schedule import Schedule
from skipnet.training.tasks.descriptor import DescriptorTask, StepPlan
from skipnet.training.trainer import Outcome, Trainer
from skipnet.viz import dashboard


class TrainableDeepNetwork(DeepNetwork):
    """The deep network as the descriptor's task trains it."""

    mixed_precision = False
    """Whether it computes in bfloat16 while it learns, where that will do."""

    _is_scaled = False

    def forward(self, grids: torch.Tensor) -> torch.Tensor:
        """See ``DeepNetwork``."""
        mixed = self.mixed_precision and self.training
        with torch.autocast(grids.device.type, torch.bfloat16, enabled=mixed):
            return super().forward(grids).float()

    def go_on_from(self, model: Model) -> None:
        """Take over the weights of a network, and how it scales its inputs.

        Raises:
            ValueError: a network of other widths.
        """
        arrays = getattr(model, "weights", {})
        tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
        try:
            self.load_state_dict(tensors, strict=True)
        except RuntimeError as error:
            raise ValueError(f"deep.start: {error}") from error
        self._is_scaled = True

    def fit_scaling(self, grids: torch.Tensor) -> None:
        """See ``DeepNetwork``; a network that goes on keeps what it has."""
        if not self._is_scaled:
            super().fit_scaling(grids)

    def arrays(self) -> dict[str, Any]:
        """Weights and scaling as ``TorchNetwork`` takes them."""
        state = self.state_dict()
        return {name: value.detach().cpu().numpy().copy() for name, value in state.items()}

    def model(self) -> TorchNetwork:
        """As it is used, with the weights that it has now, where it is now."""
        device = self.input_mean.device.type
        return TorchNetwork(self.arrays(), {"widths": self.widths}, device)


Trained = Outcome[TrainableDeepNetwork]


def train_deep(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    A run that was interrupted goes on from the checkpoint in that folder.

    Returns:
        The summary, as in summary.json: what training reached, the scores, the seconds it took.

    Raises:
        ValueError: an optimiser or device that does not exist, or the checkpoint of another run.
    """
    find_optimizer(config.optimizer)
    folder, options = Path(config.output_dir), config.deep
    find_device(config.device.value)
    write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    with lessons_of(config) as lessons:
        outcome = fit(config, lessons)
    trained_s = time.perf_counter()
    path = folder / "descriptor.npz"
    card = make_card(config, outcome) | {"hours": round((trained_s - start_s) / 3600, 2)}
    save_network(outcome.network.arrays(), card, path)
    deep = load_network(path, config.device.value)  # judged as it will be used: rounded
    test = scans_of(DEEP_TEST.take(options.test_pairs))
    scores = reports.judge_on_unseen(deep, test)
    scores["small network"] = reports.judge_on_unseen(find_network(), test)["learned"]
    card["scores"] = {name: groups["all"] for name, groups in scores.items()}
    for target in [path, DEEP_WEIGHTS] if config.ship else [path]:
        save_network(outcome.network.arrays(), card, target)
    seconds = {"training": trained_s - start_s, "judging": time.perf_counter() - trained_s}
    return conclude(config, outcome, scores, seconds, test)


def conclude(
    config: TrainConfig,
    outcome: Outcome[Any],
    scores: dict[str, dict[str, dict[str, float]]],
    seconds: dict[str, float],
    test: list[TwoScans],
) -> dict[str, Any]:
    """Write the summary and the scores of a training that the factory fed; the summary comes
    back."""
    folder = Path(config.output_dir)
    summary = {
        "experiment": config.experiment_name,
        "seed": config.seed,
        "reached": reached(outcome),
        "unseen": scores,
        "seconds": seconds,
    }
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    write_text(folder / "scores.md", reports.descriptor_table(scores))
    final = {f"{name} inlier_ratio": of["all"]["inlier_ratio"] for name, of in scores.items()}
    with dashboard.open_dashboard(folder / "tensorboard") as writer:
        reports.log_parameters(writer, config, final)
        reports.log_two_scans(writer, test[0])
    return summary


def lessons_of(config: TrainConfig) -> AbstractContextManager[PatchFactory]:
    """The factory of training pairs, working while it is open."""
    options = config.deep

    def build(pool: Executor) -> PatchFactory:
        return PatchFactory(
            partial(make_pairs, per_scans=options.patches_per_scans),
            DEEP_TRAINING,
            options.window,
            options.scans_per_step,
            options.uses,
            pool,
            options.first,
        )

    return working(config.data.workers, build)


def fit(config: TrainConfig, lessons: PatchFactory) -> Trained:
    """Train the network."""
    options = config.deep
    torch.manual_seed(config.seed)
    network = TrainableDeepNetwork(
        options.local_channels, options.hidden_units, options.output_units, options.blocks
    )
    if options.start is not None:
        network.go_on_from(find_network(options.start))
    network.mixed_precision = options.mixed_precision
    scans = scans_of(DEEP_VALIDATION.take(options.validation_pairs))
    unseen = [Keypoints.of(one, network.model()) for one in scans]
    plan = StepPlan(
        scans=options.scans_per_step,
        pairs_per_scans=options.patches_per_step // options.scans_per_step,
        temperature=options.temperature,
    )
    schedule = Schedule(
        steps=options.steps,
        round_steps=options.validate_every,
        length=f"{options.steps} steps",
        rate="warm_cosine",
        max_fail=options.patience,
    )
    with dashboard.open_dashboard(Path(config.output_dir) / "tensorboard") as writer:
        return Trainer(
            DescriptorTask(lessons, plan, unseen, config.seed),
            network,
            find_optimizer(config.optimizer),
            schedule,
            Path(config.output_dir) / CHECKPOINT,
            find_device(config.device.value),
            partial(reports.log_step, writer),
            partial(reports.log_round, writer),
            options.threads,
        ).run()


def scans_of(numbers: range) -> list[TwoScans]:
    """The factory's scans of these numbers; fewer where some have too few points."""
    made = counted("pairs of scans", map(make_scans, numbers), len(numbers))
    return [scans for scans in made if scans is not None]


def make_card(config: TrainConfig, outcome: Trained) -> dict[str, Any]:
    """What the weights are, without their scores."""
    start = config.deep.start
    described = reports.for_card(config)
    described["deep"]["start"] = None if start is None else find_network(start).digest
    return {
        "architecture": TorchNetwork.architecture,
        "widths": outcome.network.widths,
        "seed": config.seed,
        "device": config.device.value,
        "training_data": {
            "origin": "simulation only: no real scan took part",
            "kinds": {name: kind.share for name, kind in KINDS.items()},
            "numbers": int(config.deep.steps * config.deep.scans_per_step / config.deep.uses),
        },
        "reached": reached(outcome),
        "config": described,
    }
