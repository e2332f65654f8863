"""The run: every method answers every pair once, then the answers are scored and reported.

Predictions go to ``predictions.jsonl`` as they come. A run in the same folder again predicts only
what is missing, so a killed run goes on where it stopped and a finished one takes further pairs or
methods.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from skipnet.benchmark.datasets import PairSet, folder_pairs, simulated_pairs
from skipnet.benchmark.isolation import isolated
from skipnet.benchmark.methods import Estimate, Method, Task, make_method
from skipnet.benchmark.predictions import Prediction, append_prediction, read_predictions
from skipnet.benchmark.report import Results, write_report
from skipnet.benchmark.scoring import score_predictions
from skipnet.config import DatasetKind, EvaluateConfig
from skipnet.types import FloatArray, Pair

PREDICTIONS_FILE = "predictions.jsonl"


@dataclass(frozen=True)
class Contestant:
    """A method as it enters a benchmark."""

    name: str
    """Key in the predictions; unique."""
    label: str
    """Name in tables and figures."""
    run: Method
    settings_hash: str
    """Changes with the pairs' and the method's settings."""
    start_from: str = ""
    """The contestant whose coarse pose is this one's start; empty for identity."""


def run_benchmark(config: EvaluateConfig, progress: TextIO = sys.stderr) -> dict[str, Any]:
    """Predict, score and report; everything is written into ``config.output_dir``.

    Returns:
        The summary, as in summary.json.

    Raises:
        ValueError: for settings that do not fit, or a folder that holds another run's predictions.
        ImportError: when a chosen method's package is missing.
    """
    folder = Path(config.output_dir)
    pair_set, contestants = make_pair_set(config), make_contestants(config)
    path = folder / PREDICTIONS_FILE
    check_same_settings(path, contestants)
    folder.mkdir(parents=True, exist_ok=True)
    write_config(config, folder / "config.yaml")
    predict(pair_set, contestants, path, progress)
    print("scoring and drawing ...", file=progress)
    predictions = read_predictions(path)
    labels = {contestant.name: contestant.label for contestant in contestants}
    rows = score_predictions(pair_set, list(labels), predictions)
    summary = write_report(Results(describe(config), rows, predictions, labels, pair_set), folder)
    print(f"see {folder / 'report.html'}", file=progress)
    return summary


def describe(config: EvaluateConfig) -> dict[str, str]:
    """What was run, for the head of the report."""
    about = {"benchmark": config.benchmark, "methods": ", ".join(config.methods)}
    if config.dataset is DatasetKind.folder:
        about["pairs from"] = f"{config.data} ({', '.join(config.sets) or 'all sets'})"
        rotation = "a random rotation" if config.turn else "no rotation"
        about["sources moved by"] = f"{rotation}, a shift of {config.shift_m:g} m"
    else:
        about["pairs from"] = f"{config.pairs} simulated scenes of family {config.family}"
        about["scanner"] = f"{config.scanner}, rotation {config.rotation}"
    about["seed"] = str(config.seed)
    limit_s = config.time_limit_s
    about["time limit"] = "none" if limit_s is None else f"{limit_s:g} s per pair and method"
    return about


def make_pair_set(config: EvaluateConfig) -> PairSet:
    """The pairs that the config asks for."""
    if config.dataset is DatasetKind.folder:
        return folder_pairs(
            str(config.data), list(config.sets), config.turn, config.shift_m, config.seed
        )
    return simulated_pairs(
        config.family, config.pairs, config.seed, config.scanner, config.rotation, config.points
    )


def make_contestants(config: EvaluateConfig) -> list[Contestant]:
    """The chosen methods, built and ready, in the order in which they run."""
    contestants = []
    for name in config.methods:
        variant = config.variants[name]
        make = partial(make_method, variant.adapter, dict(variant.options))
        method = make()  # even if it will run in a child: a missing package must stop the run here
        contestants.append(
            Contestant(
                name=name,
                label=variant.label or name,
                run=isolated(make, config.time_limit_s) if config.time_limit_s else method,
                settings_hash=settings_hash(config, name),
                start_from=variant.start_from,
            )
        )
    return contestants


def settings_hash(config: EvaluateConfig, method: str) -> str:
    """Hash of all settings that an answer of ``method`` depends on.

    Not of how many pairs there are, nor of the other methods: a run can be extended by both.
    """
    if config.dataset is DatasetKind.folder:
        folder = Path(str(config.data)).resolve()
        pairs = ["folder", str(folder), config.turn, config.shift_m, config.seed]
    else:
        pairs = ["simulated", config.scanner, config.rotation, config.points]
    chain = [asdict(config.variants[method])]
    while chain[-1]["start_from"]:
        chain.append(asdict(config.variants[chain[-1]["start_from"]]))
    text = json.dumps([pairs, chain, config.time_limit_s], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def check_same_settings(path: Path, contestants: Iterable[Contestant]) -> None:
    """Raise a ValueError if the file has answers of one of these methods under other settings."""
    hash_of = {contestant.name: contestant.settings_hash for contestant in contestants}
    for prediction in read_predictions(path):
        if prediction.settings_hash != hash_of.get(prediction.method, prediction.settings_hash):
            raise ValueError(
                f"{path} has answers of {prediction.method} under other settings: "
                f"choose another output_dir, or remove the file"
            )


def write_config(config: EvaluateConfig, path: Path) -> None:
    """The full configuration of the run, defaults included."""
    from omegaconf import OmegaConf

    OmegaConf.save(OmegaConf.structured(config), path)


def predict(
    pair_set: PairSet, contestants: list[Contestant], path: Path, progress: TextIO = sys.stderr
) -> None:
    """Append to ``path`` the answer of every contestant to every pair for which it has none yet."""
    known = {(p.pair, p.method): p for p in read_predictions(path)}
    for index, name in enumerate(pair_set.names):
        missing = [c for c in contestants if (name, c.name) not in known]
        if not missing:
            continue
        pair = pair_set.load(index)
        print(f"[{index + 1}/{len(pair_set)}] {name}", end="", file=progress, flush=True)
        for contestant in missing:
            prediction = answer(contestant, pair, known.get((name, contestant.start_from)))
            append_prediction(path, prediction)
            known[name, contestant.name] = prediction
            word = "raised" if prediction.error else prediction.status
            print(f" | {contestant.name}: {word}, {prediction.time_s:.2f} s", end="", file=progress)
            progress.flush()
        print(file=progress)


def answer(contestant: Contestant, pair: Pair, start: Prediction | None = None) -> Prediction:
    """One contestant's answer to one pair; an exception becomes a failure with its reason.

    Args:
        contestant: the method.
        pair: of which the method sees all but the truth.
        start: the prediction whose coarse pose the method starts from; needed if it has
            ``start_from``.
    """
    failed = Prediction(pair.name, contestant.name, contestant.settings_hash, time_s=0.0)
    task = Task(pair.source_m, pair.target_m, pair.source_viewpoint_m, pair.target_viewpoint_m)
    if contestant.start_from:
        T_start = start.pose("coarse") if start is not None else None
        if T_start is None:
            return replace(
                failed, error=f"{contestant.start_from} gave no coarse pose to start from"
            )
        task = replace(task, T_target_source_start=T_start)
    started = time.perf_counter()
    try:
        estimate = contestant.run(task)
        time_s = time.perf_counter() - started
        return replace(failed, time_s=time_s, **_fields(estimate))
    except Exception as error:
        time_s = time.perf_counter() - started
        return replace(failed, time_s=time_s, error=f"{type(error).__name__}: {error}")


def _fields(estimate: Estimate) -> dict[str, Any]:
    return {
        "stage_s": dict(estimate.stage_s),
        "timings_s": dict(estimate.timings_s),
        "T_target_source": _matrix(estimate.T_target_source),
        "T_target_source_coarse": _matrix(estimate.T_target_source_coarse),
        "status": estimate.status,
        "confidence": estimate.confidence,
        "lead": estimate.lead,
        "reason": estimate.reason,
    }


def _matrix(T_target_source: FloatArray | None) -> list[list[float]] | None:
    """Nested lists for JSON; a pose of another shape or with NaN is an error of the method."""
    if T_target_source is None:
        return None
    matrix = np.asarray(T_target_source, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise ValueError(f"the method gave no pose: expected a finite 4x4 matrix, got {matrix}")
    return [[float(value) for value in row] for row in matrix]
