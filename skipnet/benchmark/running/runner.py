"""The run: every method answers every pair once, then the answers are scored and reported.

Predictions go to ``predictions.jsonl`` as they come. A run in the same folder again predicts only
what is missing, so a killed run goes on where it stopped and a finished one takes further pairs or
methods.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.methods import Estimate, Task
from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.reporting.report import Results, write_report
from skipnet.benchmark.running.setup import (
    NamedMethod,
    group_of,
    head_of_report,
    make_methods,
    make_pair_set,
    protocol_of,
)
from skipnet.benchmark.scoring.predictions import (
    Prediction,
    append_prediction,
    read_predictions,
    save_correspondences,
)
from skipnet.benchmark.scoring.scoring import Scorer, best_of_groups, choose_best, score_predictions
from skipnet.progress import in_words, say, tell
from skipnet.storage import write_config
from skipnet.types import FloatArray, Pair

PREDICTIONS_FILE = "predictions.jsonl"


def run_benchmark(config: EvaluateConfig) -> dict[str, Any]:
    """Predict, score and report; everything is written into ``config.output_dir``.

    Returns:
        The summary, as in summary.json.

    Raises:
        ValueError: for settings that do not fit, or a folder that holds another run's predictions.
        ImportError: when a chosen method's package is missing.
    """
    folder = Path(config.output_dir)
    pair_set, methods = make_pair_set(config), make_methods(config)
    path = folder / PREDICTIONS_FILE
    check_same_settings(path, methods)
    folder.mkdir(parents=True, exist_ok=True)
    write_config(config, folder / "config.yaml")
    predict(pair_set, methods, path)
    tell("scoring and drawing")
    predictions = read_predictions(path)
    labels = {method.name: method.label for method in methods}
    scorer = Scorer(protocol_of(config), folder, config.inlier_distance_m)
    rows = score_predictions(pair_set, list(labels), predictions, scorer)
    chosen = choose_best(rows, group_of(config))
    labels |= {group: group for group, _ in chosen}
    results = Results(
        about=head_of_report(config) | {"all calls took": duration(p.time_s for p in predictions)},
        settings=asdict(config),
        rows=[*rows, *best_of_groups(rows, chosen)],
        predictions=predictions,
        labels=labels,
        pair_set=pair_set,
        scorer=scorer,
        chosen=chosen,
        worst=config.worst,
    )
    summary = write_report(results, folder)
    say(f"see {folder / 'report.html'}")
    return summary


def duration(times_s: Iterable[float]) -> str:
    """The sum in words.

    >>> duration([30.0, 60.0])
    '1.5 min'
    """
    return f"{sum(times_s) / 60:.1f} min"


def check_same_settings(path: Path, methods: Iterable[NamedMethod]) -> None:
    """Raise a ValueError if the file has answers of one of these methods under other settings."""
    hash_of = {method.name: method.settings_hash for method in methods}
    for prediction in read_predictions(path):
        if prediction.settings_hash != hash_of.get(prediction.method, prediction.settings_hash):
            raise ValueError(
                f"{path} has answers of {prediction.method} under other settings: "
                f"choose another output_dir, or remove the file"
            )


def predict(pair_set: PairSet, methods: list[NamedMethod], path: Path) -> None:
    """Append to ``path`` the answer of every method to every pair for which it has none yet."""
    known = {(p.pair, p.method): p for p in read_predictions(path)}
    todo = [
        index
        for index, name in enumerate(pair_set.names)
        if any((name, method.name) not in known for method in methods)
    ]
    if len(todo) < len(pair_set):
        say(f"{len(pair_set) - len(todo)} pairs were answered before")
    started = time.perf_counter()
    for done, index in enumerate(todo):
        name = pair_set.names[index]
        pair = pair_set.load(index)
        tell("pairs", done, len(todo))
        words = []
        for method in methods:
            if (name, method.name) in known:
                continue
            start = known.get((name, method.start_from))
            tell(method.name)
            prediction = answer(method, pair, start, path.parent)
            append_prediction(path, prediction)
            known[name, method.name] = prediction
            word = "raised" if prediction.error else prediction.status
            words.append(f"{method.name}: {word}, {prediction.time_s:.2f} s")
        left_s = (time.perf_counter() - started) / (done + 1) * (len(todo) - done - 1)
        words.append(f"about {in_words(left_s)} left")
        say(f"[{index + 1}/{len(pair_set)}] {name} | " + " | ".join(words))
    tell("pairs", len(todo), len(todo))


def answer(method: NamedMethod, pair: Pair, start: Prediction | None, folder: Path) -> Prediction:
    """One method's answer to one pair; an exception becomes a failure with its reason.

    Args:
        method: to be asked.
        pair: of which the method sees all but the truth.
        start: the prediction whose coarse pose the method starts from; needed if it has
            ``start_from``.
        folder: takes the correspondences of a method that has some.
    """
    failed = Prediction(pair.name, method.name, method.settings_hash, time_s=0.0)
    task = Task(pair.source_m, pair.target_m, pair.source_viewpoint_m, pair.target_viewpoint_m)
    if method.start_from:
        T_start = start.pose("coarse") if start is not None else None
        if T_start is None:
            return replace(failed, error=f"{method.start_from} gave no coarse pose to start from")
        task = replace(task, T_target_source_start=T_start)
    started = time.perf_counter()
    try:
        estimate = method.run(task)
        # A child's start and the way of the points to it are not the method's time.
        time_s = time.perf_counter() - started if estimate.time_s is None else estimate.time_s
        prediction = replace(failed, time_s=time_s, **_fields(estimate))
        if estimate.correspondences is None:
            return prediction
        return save_correspondences(folder, prediction, *estimate.correspondences)
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
        "margin": estimate.margin,
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
