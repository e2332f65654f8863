"""Time and memory against the number of points: ``python evaluate.py benchmark=speed``.

The same simulated scenes are scanned with more and more points. All methods run in one process, one
after the other on the same scans, in an order that turns around from run to run, so that what else
the machine does meets all of them alike. Memory is measured apart, each time in a process of
its own: freed memory stays with a process, and a second method would find it there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.benchmark.methods import Method, make_method
from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.running.memory import peak_bytes, task_of
from skipnet.benchmark.scoring.measurement import Measurement
from skipnet.checks import require
from skipnet.geometry import pose_error
from skipnet.progress import counted, say
from skipnet.simulation.scanning.hard import check_kinds, hard_pair
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scenes.scenes import check_families
from skipnet.simulation.seeds import SPEED
from skipnet.types import Pair

MEASUREMENTS_FILE = "measurements.jsonl"
_WARM_UP_POINTS = 5000
"""Each method registers so small a pair first: what it imports late does not count."""
_PROBE_BEAMS = 20_000


def run_speed(config: EvaluateConfig) -> dict[str, Any]:
    """Measure all chosen methods at all sizes and write the report into ``config.output_dir``.

    Returns:
        The content of summary.json.

    Raises:
        ValueError: settings that do not fit, or a folder with the measurements of another run: what
            was timed then does not compare with what would be timed now.
        ImportError: when a chosen method's package is missing.
    """
    from skipnet.benchmark.reporting.speed_report import write_speed_report
    from skipnet.storage import write_config

    path = Path(config.output_dir) / MEASUREMENTS_FILE
    _check(config, path)
    folder = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    write_config(config, folder / "config.yaml")
    measured = []
    with open(path, "w", encoding="utf-8") as file:
        for measurement in counted("measurements", measure_all(config), _how_many(config)):
            measured.append(measurement)
            file.write(json.dumps(asdict(measurement)) + "\n")
            file.flush()
            say(_line(measurement))
    summary = write_speed_report(config, measured, folder)
    say(f"see {folder / 'report.html'}")
    return summary


def _check(config: EvaluateConfig, path: Path) -> None:
    """Refuse what cannot be measured, before anything is."""
    require(bool(config.methods), "methods", [], "at least one, methods=[NAME,NAME]")
    check_families(config.speed.families)
    check_kinds(config.speed.kinds)
    SPEED.take(config.pairs, skip=config.seed)
    for name, method in config.methods.items():
        before = method.start_from
        if before:
            raise ValueError(
                f"methods: {name} starts from the pose of {before}, and benchmark=speed times "
                f"whole methods: leave it out"
            )
    most = max(_most_points(config, name) for name in config.methods)
    if config.speed.points[0] > most:
        raise ValueError(
            f"speed.points: the smallest of {config.speed.points} is above {most:g}, the largest "
            f"size in speed.most_points of any method: choose smaller ones or more methods"
        )
    if path.exists():
        raise ValueError(f"{path} has the measurements of another run: choose another output_dir")


def measure_all(config: EvaluateConfig) -> Iterator[Measurement]:
    """Every method on every pair of every family and size, small sizes first."""
    seeds = SPEED.take(config.pairs, skip=config.seed)
    for family in config.speed.families:
        small = simulate_size(family, seeds[0], _WARM_UP_POINTS)
        methods = _warm_methods(config, family, small)
        for size in config.speed.points:
            some = {name: methods[name] for name in _methods_at(config, size)}
            for turn, seed in enumerate(seeds):
                pair = simulate_size(family, seed, size)
                for found in _in_turns(some, pair, (family, size, seed), turn, config):
                    if turn == 0 and config.speed.memory:
                        recipe = _recipe(config, found.method, family)
                        found = replace(found, extra_bytes=peak_bytes(recipe, pair, small))
                    yield found
    for kind in config.speed.kinds:
        methods = _warm_methods(config, kind, hard_pair(kind, seeds[0]))
        for turn, seed in enumerate(seeds):
            pair = hard_pair(kind, seed)
            yield from _in_turns(methods, pair, (kind, 0, seed), turn, config)


def _methods_at(config: EvaluateConfig, size: int) -> list[str]:
    """Those that may be asked about so many points."""
    return [name for name in config.methods if size <= _most_points(config, name)]


def _how_many(config: EvaluateConfig) -> int:
    """Measurements that there will be."""
    sizes = sum(len(_methods_at(config, size)) for size in config.speed.points)
    kinds = len(config.speed.kinds) * len(config.methods)
    return config.pairs * (len(config.speed.families) * sizes + kinds)


def _warm_methods(config: EvaluateConfig, family: str, pair: Pair) -> dict[str, Method]:
    """The chosen methods, each of which has registered a pair."""
    methods = {name: make_method(*_recipe(config, name, family)) for name in config.methods}
    for name, method in methods.items():
        measure(method, pair, Measurement(family, 0, name, 0, 0, 0, False))
    return methods


def _in_turns(
    methods: Mapping[str, Method],
    pair: Pair,
    about: tuple[str, int, int],
    turn: int,
    config: EvaluateConfig,
) -> list[Measurement]:
    """The middle run of each method on a pair, of so many as ``config`` says, taking turns.

    Args:
        methods: by name.
        pair: to register.
        about: family, size and seed.
        turn: number of the pair: which method begins changes with it.
        config: says how often.
    """
    family, size, seed = about
    runs: dict[str, list[Measurement]] = {name: [] for name in methods}
    for repeat in range(config.speed.repeats):
        for name in list(methods)[:: 1 if (turn + repeat) % 2 == 0 else -1]:
            blank = Measurement(family, size, name, seed, 0, 0, False)
            runs[name].append(measure(methods[name], pair, blank))
    return [middle(same) for same in runs.values()]


def simulate_size(family: str, seed: int, points: int) -> Pair:
    """Two scans of a scene with about so many points each: as many beams as that takes.

    Before a facade half of all beams meet nothing. A scan of few beams tells what share returns.
    """
    probe = simulate_pair(family, seed, points=_PROBE_BEAMS).pair
    returned = (len(probe.source_m) + len(probe.target_m)) / 2
    return simulate_pair(family, seed, points=round(points * _PROBE_BEAMS / returned)).pair


def middle(runs: Sequence[Measurement]) -> Measurement:
    """The run of the middle time among repeated ones, of two the longer.

    It is right if all are, and has the error of the first that failed.
    """
    found = sorted(runs, key=lambda run: run.time_s)[len(runs) // 2]
    error = next((run.error for run in runs if run.error), "")
    return replace(found, is_right=all(run.is_right for run in runs), error=error)


def measure(method: Method, pair: Pair, about: Measurement) -> Measurement:
    """Time one call; an exception becomes an answer that is wrong, with its reason."""
    found = replace(
        about,
        is_right=False,
        points=len(pair.source_m) + len(pair.target_m),
        input_bytes=pair.source_m.nbytes + pair.target_m.nbytes,
    )
    task = task_of(pair)
    started = time.perf_counter()
    try:
        estimate = method(task)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        return replace(found, time_s=time.perf_counter() - started, error=reason)
    time_s = time.perf_counter() - started
    rotation_rad, translation_m = pose_error(estimate.T_target_source, pair.T_target_source)
    # What shares nothing has no right pose: a method that knows it does not register it.
    is_right = (
        estimate.status != "registered"
        if pair.overlap == 0
        else (
            rotation_rad < pair.success_rotation_rad and translation_m < pair.success_translation_m
        )
    )
    stages_s = dict(estimate.timings_s or estimate.stage_s)
    return replace(found, time_s=time_s, is_right=is_right, stages_s=stages_s)


def _recipe(config: EvaluateConfig, name: str, family: str) -> tuple[str, Mapping[str, Any]]:
    """What makes a method for one family, and its options there."""
    method = config.methods[name]
    options = dict(method.options)
    voxel_size_m = config.speed.voxels_m.get(family, {}).get(name)
    if voxel_size_m is not None:
        options["voxel_size_m"] = voxel_size_m
    return method.make, options


def _most_points(config: EvaluateConfig, name: str) -> float:
    return config.speed.most_points.get(name, np.inf)


def _line(found: Measurement) -> str:
    outcome = found.error or ("right" if found.is_right else "wrong")
    size = f"{found.family} {found.points // 2:,} points, scene {found.seed}"
    return f"{size} | {found.method}: {found.time_s:.3f} s, {outcome}"
