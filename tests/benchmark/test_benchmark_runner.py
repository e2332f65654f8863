"""The run: truth stays with the scorer, failures count, killed runs go on where they stopped."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.methods import Estimate
from skipnet.benchmark.options import DisturbanceConfig, ProtocolKind
from skipnet.benchmark.running.isolation import isolated
from skipnet.benchmark.running.runner import check_same_settings, predict
from skipnet.benchmark.running.setup import NamedMethod, settings_hash
from skipnet.benchmark.scoring.predictions import Prediction, append_prediction, read_predictions
from skipnet.benchmark.scoring.scoring import (
    Scorer,
    best_of_groups,
    choose_best,
    score_predictions,
    write_scores,
)
from skipnet.benchmark.scoring.summary import summarise
from skipnet.geometry import make_transform
from skipnet.types import Pair
from tests.composing import evaluate_options

TRUTH = make_transform(np.eye(3), np.array([1.0, 2.0, 3.0]))


def make_pairs(count=3):
    points_m = np.random.default_rng(0).uniform(-1, 1, (30, 3))

    def load(index):
        return Pair(f"pair-{index}", "toy", points_m, points_m + TRUTH[:3, 3], TRUTH)

    return PairSet(tuple(f"pair-{index}" for index in range(count)), load)


def score(pairs, methods, predictions, folder="."):
    return score_predictions(
        pairs, methods, predictions, Scorer(ProtocolKind.own, Path(folder), inlier_distance_m=0.1)
    )


def shifted(x_m):
    return make_transform(np.eye(3), np.array([1.0 + x_m, 2.0, 3.0]))


def two_staged(task):
    stage_s = {"map": 2.0, "transform": 1.0, "fine": 0.5}
    return Estimate(shifted(0.001), stage_s, shifted(0.299))


def local(task):
    """Answers where it started."""
    return Estimate(task.T_target_source_start, {"fine": 0.1})


def raising(task):
    raise ArithmeticError("no inliers")


def named(name, run, start_from=""):
    return NamedMethod(
        name, name.upper(), run, settings_hash=f"hash of {name}", start_from=start_from
    )


def test_scores_of_a_run_by_hand(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs()
    entrants = [
        named("ours", two_staged),
        named("icp", local),
        named("icp_from_ours", local, start_from="ours"),
    ]
    predict(pairs, entrants, path)
    rows = score(pairs, [c.name for c in entrants], read_predictions(path))
    table = {
        (e["method"], e["stage"]): e for e in summarise(rows, {c.name: c.label for c in entrants})
    }
    assert list(table) == [
        ("ours", "coarse"), ("ours", "fine"), ("icp", "fine"), ("icp_from_ours", "fine")
    ]  # fmt: skip
    assert [entry["successes"] for entry in table.values()] == [0, 3, 0, 0]
    assert table["ours", "coarse"]["median"]["x_error_mm"] == pytest.approx(299)
    assert table["ours", "coarse"]["median"]["mean_error_mm"] == pytest.approx(299 / 3)
    assert table["ours", "coarse"]["median"]["time_s"] == pytest.approx(3.0)
    assert table["ours", "fine"]["median"]["time_s"] == pytest.approx(0.5)
    assert table["ours", "fine"]["mean"]["x_error_mm"] == pytest.approx(1)
    assert table["icp", "fine"]["median"]["z_error_mm"] == pytest.approx(3000)
    assert table["icp_from_ours", "fine"]["median"]["x_error_mm"] == pytest.approx(299)


def test_a_method_sees_no_truth(tmp_path):
    seen = []

    def spy(task):
        seen.append(task)
        return local(task)

    predict(make_pairs(1), [named("spy", spy)], tmp_path / "p.jsonl")
    (task,) = seen
    assert not any(np.array_equal(value, TRUTH) for value in vars(task).values())
    np.testing.assert_array_equal(task.T_target_source_start, np.eye(4))


def test_an_exception_is_a_failed_pair_that_counts(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(4)

    calls = iter(range(4))

    def sometimes(task):
        return raising(task) if next(calls) == 2 else two_staged(task)

    predict(pairs, [named("shaky", sometimes)], path)
    failed = read_predictions(path)[2]
    assert failed.error == "ArithmeticError: no inliers"
    assert failed.T_target_source is None
    coarse, fine = summarise(score(pairs, ["shaky"], read_predictions(path)), {"shaky": "S"})
    assert (fine["successes"], fine["pairs"], fine["poses"]) == (3, 4, 3)
    assert fine["success_rate"] == 0.75
    assert coarse["pairs"] == 4
    assert fine["largest"]["mean_error_mm"] is None  # infinite


def test_most_pairs_failed_means_no_median(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(2)
    predict(pairs, [named("broken", raising)], path)
    (entry,) = summarise(score(pairs, ["broken"], read_predictions(path)), {"broken": "B"})
    assert entry["success_rate"] == 0.0
    assert entry["median"]["mean_error_mm"] is None
    assert entry["mean"]["mean_error_mm"] is None
    json.dumps(entry, allow_nan=False)


def test_a_dependent_method_fails_with_the_one_it_starts_from(tmp_path):
    path = tmp_path / "predictions.jsonl"
    entrants = [named("ours", raising), named("icp", local, start_from="ours")]
    predict(make_pairs(1), entrants, path)
    assert "ours gave no coarse pose" in read_predictions(path)[1].error


@pytest.mark.parametrize("pose", [np.full((4, 4), np.nan), np.eye(3)])
def test_an_answer_that_is_no_pose_is_a_failure(tmp_path, pose):
    path = tmp_path / "predictions.jsonl"
    broken = named("broken", lambda task: Estimate(pose, {"fine": 0.1}))
    predict(make_pairs(1), [broken], path)
    assert "no pose" in read_predictions(path)[0].error


def test_a_killed_run_goes_on_where_it_stopped(tmp_path):
    path, pairs, calls = tmp_path / "predictions.jsonl", make_pairs(3), []

    def counting(task):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return two_staged(task)

    with pytest.raises(KeyboardInterrupt):
        predict(pairs, [named("ours", counting)], path)
    with path.open("a") as file:
        file.write('{"pair": "pair-2", "meth')  # the kill came in the middle of a line
    predict(pairs, [named("ours", counting)], path)
    assert len(calls) == 4
    assert [p.pair for p in read_predictions(path)] == list(pairs.names)
    # Nothing is missing now: nothing is loaded, nothing is called.
    predict(replace(pairs, load=None), [named("ours", raising)], path)


def test_predictions_survive_the_file_to_the_last_bit(tmp_path):
    path = tmp_path / "predictions.jsonl"
    matrix = np.random.default_rng(0).standard_normal((4, 4)).tolist()
    prediction = Prediction(
        "a", "m", "hash", 0.1, {"fine": 0.1}, {}, matrix, None, "registered", 0.9
    )
    append_prediction(path, prediction)
    assert read_predictions(path) == [prediction]


def test_a_line_that_is_no_prediction_is_named(tmp_path):
    path = tmp_path / "predictions.jsonl"
    path.write_text('{"other": 1}\n')
    with pytest.raises(ValueError, match="line 1"):
        read_predictions(path)


def test_scores_need_every_prediction():
    with pytest.raises(ValueError, match="3 predictions are missing"):
        score(make_pairs(3), ["ours"], [])


def test_scores_csv_has_units_in_its_headers(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(1)
    predict(pairs, [named("ours", two_staged)], path)
    write_scores(score(pairs, ["ours"], read_predictions(path)), tmp_path / "scores.csv")
    with (tmp_path / "scores.csv").open() as file:
        record, _ = csv.DictReader(file)
    assert float(record["x_error_mm"]) == pytest.approx(299)
    assert (record["stage"], record["success"]) == ("coarse", "False")
    # Each rule has a column of its own; this pair has no gt.info, so that one says nothing.
    rules = [record[f"right_{name}"] for name in ("own", "deg15_30cm", "deg5_2m", "rmse_20cm")]
    assert rules == ["False", "True", "True", ""]


def test_other_settings_do_not_reuse_answers(tmp_path):
    path = tmp_path / "predictions.jsonl"
    predict(make_pairs(1), [named("ours", two_staged)], path)
    changed = NamedMethod("ours", "OURS", two_staged, settings_hash="another")
    with pytest.raises(ValueError, match="output_dir"):
        check_same_settings(path, [changed])
    check_same_settings(path, [named("icp", local)])


def test_settings_hash_sees_what_is_in_the_weights_file(tmp_path):
    weights = tmp_path / "w.npz"
    options = {"descriptor": "learned", "weights": str(weights)}
    config = evaluate_options("methods=[learned_sc2,icp]")
    config.methods["learned_sc2"].options = options
    hashes = []
    for content in (b"one", b"two"):
        weights.write_bytes(content)
        hashes.append([settings_hash(config, name) for name in ("learned_sc2", "icp")])
    assert hashes[0][0] != hashes[1][0] and hashes[0][1] == hashes[1][1]


def test_settings_hash_sees_what_an_answer_depends_on():
    config = evaluate_options()
    known = settings_hash(config, "icp_from_coarse")
    assert settings_hash(replace(config, pairs=3), "icp_from_coarse") == known
    assert settings_hash(evaluate_options("benchmark=simulated"), "icp_from_coarse") == known
    assert settings_hash(replace(config, points=1000), "icp_from_coarse") != known
    noisy = replace(config, disturbances=[DisturbanceConfig("noisy", noise_m=0.1)])
    assert settings_hash(noisy, "icp_from_coarse") != known
    judged = replace(config, protocol=ProtocolKind.deg5_2m)
    assert settings_hash(judged, "icp_from_coarse") == known
    other_start = evaluate_options("+methods.skipnet.options.voxel_size_m=0.2")
    assert settings_hash(other_start, "icp_from_coarse") != known


def make_slow(seconds):
    def run(task):
        time.sleep(seconds if task.source_m[0, 0] > 0 else 0.0)
        return local(task)

    return run


def make_raising():
    return raising


def test_a_hang_costs_one_pair_and_the_next_still_runs():
    from skipnet.benchmark.methods import Task

    run = isolated(partial(make_slow, 30.0), limit_s=1.0)
    points_m = np.ones((5, 3))
    started = time.perf_counter()
    with pytest.raises(TimeoutError, match="1 s"):
        run(Task(points_m, points_m))
    assert time.perf_counter() - started < 20.0
    np.testing.assert_array_equal(run(Task(-points_m, points_m)).T_target_source, np.eye(4))


def test_an_exception_crosses_the_process():
    from skipnet.benchmark.methods import Task

    with pytest.raises(ArithmeticError, match="no inliers"):
        isolated(make_raising, limit_s=20.0)(Task(np.ones((5, 3)), np.ones((5, 3))))


def make_dying():
    return dying


def dying(task):
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_method_that_dies_fails_its_pair_and_the_next_still_runs(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(2)
    entrants = [
        named("mortal", isolated(make_dying)),
        named("icp", isolated(partial(make_slow, 0.0))),
    ]
    predict(pairs, entrants, path)
    mortal, icp = read_predictions(path)[2:]
    assert "died (exit code -9)" in mortal.error
    assert icp.error is None
    first, second = summarise(
        score(pairs, ["mortal", "icp"], read_predictions(path)), {"mortal": "M", "icp": "I"}
    )
    assert (first["pairs"], first["poses"], second["poses"]) == (2, 0, 2)


def report_threads(task):
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    reason = f"{os.environ['OMP_NUM_THREADS']} {os.environ['OPENBLAS_NUM_THREADS']} {processors}"
    return Estimate(np.eye(4), {}, reason=reason)


def make_reporter():
    return report_threads


def test_threads_are_fixed_in_the_method_and_stay_as_they_were_outside():
    from skipnet.benchmark.methods import Task

    before = dict(os.environ)
    task = Task(np.ones((5, 3)), np.ones((5, 3)))
    assert isolated(make_reporter, threads=1)(task).reason == "1 1 1"
    assert dict(os.environ) == before


def test_correspondences_are_kept_beside_the_predictions_and_scored(tmp_path):
    """Two of four correspondences are exact, one is 5 cm off, one 5 m."""
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(1)
    offsets_m = np.array([[0.0, 0, 0], [0, 0, 0], [0.05, 0, 0], [5, 0, 0]])

    def matching(task):
        matches = task.source_m[:4], task.source_m[:4] + TRUTH[:3, 3] + offsets_m
        return Estimate(shifted(0.0), {"fine": 0.1}, correspondences=matches)

    predict(pairs, [named("matching", matching)], path)
    for distance_m, ratio in ((0.1, 0.75), (0.01, 0.5)):
        scorer = Scorer(ProtocolKind.own, tmp_path, distance_m)
        (row,) = score_predictions(pairs, ["matching"], read_predictions(path), scorer)
        assert row.inlier_ratio == ratio
        (entry,) = summarise([row], {"matching": "M"})
        assert (entry["mean_inlier_ratio"], entry["feature_matching_recall"]) == (ratio, 1.0)


def test_the_best_method_of_a_group_is_chosen_set_by_set(tmp_path):
    """Small voxels are right in the first set, large ones in the second; together in both."""
    path = tmp_path / "predictions.jsonl"
    points_m = np.random.default_rng(0).uniform(-1, 1, (30, 3))

    def load(index):
        moved_m = points_m + index
        return Pair(f"p{index}", f"set-{index}", moved_m, moved_m + TRUTH[:3, 3], TRUTH)

    def right_if(condition):
        return lambda task: Estimate(shifted(0.0 if condition(task) else 9.0), {"fine": 1.0})

    entrants = [
        named("small", right_if(lambda task: task.source_m.mean() < 0.5)),
        named("large", right_if(lambda task: task.source_m.mean() >= 0.5)),
    ]
    pairs = PairSet(("p0", "p1"), load)
    predict(pairs, entrants, path)
    rows = score(pairs, ["small", "large"], read_predictions(path))
    chosen = choose_best(rows, {"small": "best", "large": "best"})
    assert chosen == {("best", "set-0"): "small", ("best", "set-1"): "large"}
    best = best_of_groups(rows, chosen)
    assert [(row.method, row.set, row.success) for row in best] == [
        ("best", "set-0", True), ("best", "set-1", True)
    ]  # fmt: skip
    assert sum(row.success for row in rows) == 2


def test_a_protocol_that_fits_no_pair_is_refused(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(1)
    predict(pairs, [named("icp", local)], path)
    scorer = Scorer(ProtocolKind.rmse_20cm, tmp_path)
    with pytest.raises(ValueError, match="protocol=deg15_30cm"):
        score_predictions(pairs, ["icp"], read_predictions(path), scorer)


SLEEPER = """
import numpy as np, os, sys, time
from functools import partial
sys.path.insert(0, "tests/benchmark")
from skipnet.benchmark.running.isolation import isolated
from skipnet.benchmark.methods import Task
from tests.composing import evaluate_options
from test_benchmark_runner import make_sleeper

if __name__ == "__main__":
    isolated(make_sleeper)(Task(np.ones((5, 3)), np.ones((5, 3))))
"""


def make_sleeper():
    def run(task):
        print(os.getpid(), flush=True)
        time.sleep(60)

    return run


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a child of its parent's end")
def test_a_killed_run_leaves_no_method_behind(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SLEEPER)
    root = Path(__file__).parents[2]
    run = subprocess.Popen(
        [sys.executable, script], cwd=root, env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    child = int(run.stdout.readline())
    run.kill()
    run.wait()
    deadline = time.monotonic() + 20
    while Path(f"/proc/{child}").exists() and time.monotonic() < deadline:
        if "State:\tZ" in Path(f"/proc/{child}/status").read_text():
            break  # dead, and nobody has asked how it ended
        time.sleep(0.05)
    else:
        assert not Path(f"/proc/{child}").exists()
