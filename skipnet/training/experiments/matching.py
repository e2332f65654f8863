"""The matcher: fed by the factory as it learns, upon a deep network that stays as it is."""

from __future__ import annotations

import time
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import torch

from skipnet.metrics.correspondences import TwoScans, by_matcher, match, summarise_by_overlap
from skipnet.networks.catalog import find_deep, load_matcher, save_network
from skipnet.networks.devices import find_device
from skipnet.networks.matcher import MatcherNetwork
from skipnet.networks.names import MATCHER_WEIGHTS
from skipnet.networks.numpy_matcher import NumpyMatcher
from skipnet.networks.on_grids import OnGrids
from skipnet.networks.tokens import Tokens
from skipnet.progress import counted
from skipnet.simulation.seeds import DEEP_TEST, DEEP_TRAINING, DEEP_VALIDATION
from skipnet.storage import write_config
from skipnet.training import reports
from skipnet.training.data.factory import KINDS, Factory, working
from skipnet.training.data.token_pairs import Hiding, TokenPair, make_token_pair
from skipnet.training.experiments.both_heads import CHECKPOINT, reached
from skipnet.training.experiments.deep_descriptor import conclude, scans_of
from skipnet.training.optimizers import find_optimizer
from skipnet.training.options import TrainConfig
from skipnet.training.schedule import Schedule
from skipnet.training.tasks.matching import MatchingPlan, MatchingTask
from skipnet.training.trainer import Outcome, Trainer
from skipnet.viz import dashboard

MATCHES = "matcher.npz"


class TrainableMatcher(MatcherNetwork):
    """The matcher as its task trains it."""

    mixed_precision = False
    """Whether it computes in bfloat16 while it learns, where that will do."""

    def forward(
        self, source: Tokens, target: Tokens, oriented: bool
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """See ``MatcherNetwork``."""
        mixed = self.mixed_precision and self.training
        with torch.autocast(source.units.device.type, torch.bfloat16, enabled=mixed):
            found = super().forward(source, target, oriented)
        alike, partner_s, partner_t = (values.float() for values in found)
        return alike, partner_s, partner_t

    def begin(self, describes: OnGrids, start: str | None) -> None:
        """Take over the descriptors of the deep network, or all weights of another matcher.

        Raises:
            ValueError: a matcher of other widths.
        """
        arrays = load_matcher(Path(start)).weights if start is not None else self.arrays()
        if start is None:
            for kind in ("weight", "bias"):
                arrays[f"output.{kind}"] = describes.weights[f"output.{kind}"]
        try:
            self.load_state_dict({name: torch.from_numpy(a) for name, a in arrays.items()})
        except RuntimeError as error:
            raise ValueError(f"matcher.start: {error}") from error

    def arrays(self) -> dict[str, Any]:
        """Weights as ``NumpyMatcher`` takes them."""
        state = self.state_dict()
        return {name: value.detach().cpu().numpy().copy() for name, value in state.items()}


Trained = Outcome[TrainableMatcher]


def train_matcher(config: TrainConfig) -> dict[str, Any]:
    """Train and judge as configured; everything is written into ``config.output_dir``.

    A run that was interrupted goes on from the checkpoint in that folder.

    Returns:
        The summary, as in summary.json: what training reached, the scores, the seconds it took.

    Raises:
        ValueError: an optimiser or device that does not exist, or the checkpoint of another run.
    """
    find_optimizer(config.optimizer)
    folder, options = Path(config.output_dir), config.matcher
    find_device(config.device.value)
    describes = find_deep(options.describes, "matcher.describes")
    write_config(config, folder / "config.yaml")
    start_s = time.perf_counter()
    with lessons_of(config) as lessons:
        outcome = fit(config, describes, lessons)
    trained_s = time.perf_counter()
    card = make_card(config, describes, outcome)
    card["hours"] = round((trained_s - start_s) / 3600, 2)
    save_network(outcome.network.arrays(), card, folder / MATCHES)
    test = scans_of(DEEP_TEST.take(options.test_pairs))
    scores = judge(load_matcher(folder / MATCHES), describes, test)
    card["scores"] = {name: groups["all"] for name, groups in scores.items()}
    for target in [folder / MATCHES, MATCHER_WEIGHTS] if config.ship else [folder / MATCHES]:
        save_network(outcome.network.arrays(), card, target)
    seconds = {"training": trained_s - start_s, "judging": time.perf_counter() - trained_s}
    return conclude(config, outcome, scores, seconds, test)


def judge(
    matcher: NumpyMatcher, describes: OnGrids, test: list[TwoScans]
) -> dict[str, dict[str, dict[str, float]]]:
    """Scores on the test's scans: of the matcher, and of the network and FPFH without it."""
    found = [
        match(scans, partial(by_matcher, network=describes, matcher=matcher))
        for scans in counted("pairs to match", test, len(test))
    ]
    without = reports.judge_on_unseen(describes, test)
    return {
        "learned": summarise_by_overlap(found),
        "network alone": without.pop("learned"),
        **without,
    }


def lessons_of(config: TrainConfig) -> AbstractContextManager[Factory[TokenPair]]:
    """The factory of training pairs, working while it is open."""
    options = config.matcher

    def build(pool: Executor) -> Factory[TokenPair]:
        return Factory(
            partial(make_token_pair, describes=options.describes),
            DEEP_TRAINING,
            options.window,
            options.scans_per_step,
            options.uses,
            pool,
            options.first,
        )

    return working(config.data.workers, build)


def fit(config: TrainConfig, describes: OnGrids, lessons: Factory[TokenPair]) -> Trained:
    """Train the network."""
    options = config.matcher
    torch.manual_seed(config.seed)
    sizes = describes.card["widths"]
    network = TrainableMatcher(
        sizes["hidden"], sizes["output"], options.width, options.heads, options.layers
    )
    network.begin(describes, options.start)
    network.mixed_precision = options.mixed_precision
    numbers = DEEP_VALIDATION.take(options.validation_pairs)
    made = counted(
        "pairs of scans", (make_token_pair(n, options.describes) for n in numbers), len(numbers)
    )
    unseen = [pair for pair in made if pair is not None]
    schedule = Schedule(
        steps=options.steps,
        round_steps=options.validate_every,
        length=f"{options.steps} steps",
        rate="warm_cosine",
        max_fail=options.patience,
    )
    hiding = Hiding(options.cropped_share, options.dropped_share, options.jitter_voxels)
    plan = MatchingPlan(options.scans_per_step, options.keypoints, hiding)
    with dashboard.open_dashboard(Path(config.output_dir) / "tensorboard") as writer:
        return Trainer(
            MatchingTask(lessons, plan, unseen, config.seed),
            network,
            find_optimizer(config.optimizer),
            schedule,
            Path(config.output_dir) / CHECKPOINT,
            find_device(config.device.value),
            partial(reports.log_step, writer),
            partial(reports.log_round, writer),
            options.threads,
        ).run()


def make_card(config: TrainConfig, describes: OnGrids, outcome: Trained) -> dict[str, Any]:
    """What the weights are, without their scores."""
    options, described = config.matcher, reports.for_card(config)
    start = None if options.start is None else load_matcher(Path(options.start)).digest
    described["matcher"] |= {"start": start, "describes": describes.digest}
    return {
        "architecture": NumpyMatcher.architecture,
        "widths": outcome.network.widths,
        "describes": describes.digest,
        "seed": config.seed,
        "device": config.device.value,
        "training_data": {
            "origin": "simulation only: no real scan took part",
            "kinds": {name: kind.share for name, kind in KINDS.items()},
            "numbers": int(options.steps * options.scans_per_step / options.uses),
        },
        "reached": reached(outcome),
        "config": described,
    }
