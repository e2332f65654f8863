"""The run: truth stays with the scorer, failures count, killed runs go on where they stopped."""

import io
import json
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from skipnet.benchmark.datasets import PairSet
from skipnet.benchmark.isolation import isolated
from skipnet.benchmark.methods import Estimate
from skipnet.benchmark.predictions import Prediction, append_prediction, read_predictions
from skipnet.benchmark.runner import Contestant, check_same_settings, predict, settings_hash
from skipnet.benchmark.scoring import score_predictions, summarise, write_scores
from skipnet.config import EvaluateConfig, VariantConfig
from skipnet.geometry import make_transform
from skipnet.types import Pair

TRUTH = make_transform(np.eye(3), np.array([1.0, 2.0, 3.0]))


def make_pairs(count=3):
    points_m = np.random.default_rng(0).uniform(-1, 1, (30, 3))

    def load(index):
        return Pair(f"pair-{index}", "toy", points_m, points_m + TRUTH[:3, 3], TRUTH)

    return PairSet(tuple(f"pair-{index}" for index in range(count)), load)


def shifted(x_m):
    return make_transform(np.eye(3), np.array([1.0 + x_m, 2.0, 3.0]))


def two_staged(task):
    return Estimate(shifted(0.001), {"map": 2.0, "transform": 1.0, "fine": 0.5}, shifted(0.3))


def local(task):
    """Answers where it started."""
    return Estimate(task.T_target_source_start, {"fine": 0.1})


def raising(task):
    raise ArithmeticError("no inliers")


def contestant(name, run, start_from=""):
    return Contestant(
        name, name.upper(), run, settings_hash=f"hash of {name}", start_from=start_from
    )


def test_scores_of_a_run_by_hand(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs()
    entrants = [
        contestant("ours", two_staged),
        contestant("icp", local),
        contestant("icp_from_ours", local, start_from="ours"),
    ]
    predict(pairs, entrants, path, io.StringIO())
    rows = score_predictions(pairs, [c.name for c in entrants], read_predictions(path))
    table = {
        (e["method"], e["stage"]): e for e in summarise(rows, {c.name: c.label for c in entrants})
    }
    assert list(table) == [
        ("ours", "coarse"), ("ours", "fine"), ("icp", "fine"), ("icp_from_ours", "fine")
    ]  # fmt: skip
    assert [entry["successes"] for entry in table.values()] == [0, 3, 0, 0]
    assert table["ours", "coarse"]["median"]["x_error_mm"] == pytest.approx(300)
    assert table["ours", "coarse"]["median"]["mean_error_mm"] == pytest.approx(100)
    assert table["ours", "coarse"]["median"]["time_s"] == pytest.approx(3.0)
    assert table["ours", "fine"]["median"]["time_s"] == pytest.approx(0.5)
    assert table["ours", "fine"]["mean"]["x_error_mm"] == pytest.approx(1)
    assert table["icp", "fine"]["median"]["z_error_mm"] == pytest.approx(3000)
    assert table["icp_from_ours", "fine"]["median"]["x_error_mm"] == pytest.approx(300)


def test_a_method_sees_no_truth(tmp_path):
    seen = []

    def spy(task):
        seen.append(task)
        return local(task)

    predict(make_pairs(1), [contestant("spy", spy)], tmp_path / "p.jsonl", io.StringIO())
    (task,) = seen
    assert not any(np.array_equal(value, TRUTH) for value in vars(task).values())
    np.testing.assert_array_equal(task.T_target_source_start, np.eye(4))


def test_an_exception_is_a_failed_pair_that_counts(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(4)

    calls = iter(range(4))

    def sometimes(task):
        return raising(task) if next(calls) == 2 else two_staged(task)

    predict(pairs, [contestant("shaky", sometimes)], path, io.StringIO())
    failed = read_predictions(path)[2]
    assert failed.error == "ArithmeticError: no inliers"
    assert failed.T_target_source is None
    coarse, fine = summarise(
        score_predictions(pairs, ["shaky"], read_predictions(path)), {"shaky": "S"}
    )
    assert (fine["successes"], fine["pairs"], fine["poses"]) == (3, 4, 3)
    assert fine["success_rate"] == 0.75
    assert coarse["pairs"] == 4
    assert fine["largest"]["mean_error_mm"] is None  # infinite


def test_most_pairs_failed_means_no_median(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(2)
    predict(pairs, [contestant("broken", raising)], path, io.StringIO())
    (entry,) = summarise(
        score_predictions(pairs, ["broken"], read_predictions(path)), {"broken": "B"}
    )
    assert entry["success_rate"] == 0.0
    assert entry["median"]["mean_error_mm"] is None
    assert entry["mean"]["mean_error_mm"] is None
    json.dumps(entry, allow_nan=False)


def test_a_dependent_method_fails_with_the_one_it_starts_from(tmp_path):
    path = tmp_path / "predictions.jsonl"
    entrants = [contestant("ours", raising), contestant("icp", local, start_from="ours")]
    predict(make_pairs(1), entrants, path, io.StringIO())
    assert "ours gave no coarse pose" in read_predictions(path)[1].error


@pytest.mark.parametrize("pose", [np.full((4, 4), np.nan), np.eye(3)])
def test_an_answer_that_is_no_pose_is_a_failure(tmp_path, pose):
    path = tmp_path / "predictions.jsonl"
    broken = contestant("broken", lambda task: Estimate(pose, {"fine": 0.1}))
    predict(make_pairs(1), [broken], path, io.StringIO())
    assert "no pose" in read_predictions(path)[0].error


def test_a_killed_run_goes_on_where_it_stopped(tmp_path):
    path, pairs, calls = tmp_path / "predictions.jsonl", make_pairs(3), []

    def counting(task):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return two_staged(task)

    with pytest.raises(KeyboardInterrupt):
        predict(pairs, [contestant("ours", counting)], path, io.StringIO())
    with path.open("a") as file:
        file.write('{"pair": "pair-2", "meth')  # the kill came in the middle of a line
    predict(pairs, [contestant("ours", counting)], path, io.StringIO())
    assert len(calls) == 4
    assert [p.pair for p in read_predictions(path)] == list(pairs.names)
    # Nothing is missing now: nothing is loaded, nothing is called.
    predict(replace(pairs, load=None), [contestant("ours", raising)], path, io.StringIO())


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
        score_predictions(make_pairs(3), ["ours"], [])


def test_scores_csv_has_units_in_its_headers(tmp_path):
    path, pairs = tmp_path / "predictions.jsonl", make_pairs(1)
    predict(pairs, [contestant("ours", two_staged)], path, io.StringIO())
    write_scores(
        score_predictions(pairs, ["ours"], read_predictions(path)), tmp_path / "scores.csv"
    )
    header, coarse, fine = (tmp_path / "scores.csv").read_text().splitlines()
    record = dict(zip(header.split(","), coarse.split(","), strict=True))
    assert float(record["x_error_mm"]) == pytest.approx(300)
    assert (record["stage"], record["success"]) == ("coarse", "False")


def test_other_settings_do_not_reuse_answers(tmp_path):
    path = tmp_path / "predictions.jsonl"
    predict(make_pairs(1), [contestant("ours", two_staged)], path, io.StringIO())
    changed = Contestant("ours", "OURS", two_staged, settings_hash="another")
    with pytest.raises(ValueError, match="output_dir"):
        check_same_settings(path, [changed])
    check_same_settings(path, [contestant("icp", local)])


def test_settings_hash_sees_what_an_answer_depends_on():
    config = EvaluateConfig()
    known = settings_hash(config, "icp_from_coarse")
    assert settings_hash(replace(config, pairs=3, methods=["icp"]), "icp_from_coarse") == known
    assert settings_hash(replace(config, points=1000), "icp_from_coarse") != known
    other_start = {**config.variants, "skipnet": VariantConfig(options={"voxel_size_m": 0.2})}
    assert settings_hash(replace(config, variants=other_start), "icp_from_coarse") != known


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
