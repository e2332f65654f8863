"""benchmark=speed: what it measures, and what its report says of it."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from skipnet.benchmark.methods import Estimate
from skipnet.benchmark.options import SpeedConfig
from skipnet.benchmark.reporting.speed_tables import exponents, summarise
from skipnet.benchmark.running.speed import measure, middle, peak_bytes, run_speed, simulate_size
from skipnet.benchmark.scoring.measurement import Measurement
from skipnet.progress import listening
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import SPEED
from tests.composing import evaluate_options

SIZES = [2000, 4000]


def measurement(size, time_s, method="skipnet", **fields):
    return Measurement("paper_room", size, method, 0, 2 * size, time_s, True, **fields)


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=20_000).pair


@pytest.mark.parametrize("power", [0.5, 1.0, 1.7])
def test_the_exponent_is_that_of_the_law_the_times_follow(power):
    measured = [measurement(n, 3e-6 * n**power) for n in (1000, 10_000, 50_000)]
    measured += [measurement(n, 1.0, "other") for n in (1000, 10_000)] + [measurement(9, 1, "once")]
    found = exponents(measured)["paper_room"]
    assert found == {"skipnet": pytest.approx(power), "other": pytest.approx(0.0, abs=1e-12)}


def test_the_exponent_of_the_largest_sizes_leaves_out_what_does_not_grow():
    measured = [measurement(n, 1.0) for n in (10, 100)]
    measured += [measurement(n, 1e-3 * n) for n in (10_000, 100_000, 1_000_000)]
    assert exponents(measured)["paper_room"]["skipnet"] < 0.9
    assert exponents(measured, 3)["paper_room"]["skipnet"] == pytest.approx(1.0)


def test_medians_are_over_the_pairs_of_one_size_and_method():
    measured = [measurement(10, t, stages_s={"map": t / 2}) for t in (1.0, 5.0, 2.0)]
    measured.append(measurement(10, 7.0, "other", extra_bytes=30, input_bytes=10))
    ours, other = summarise(measured)
    assert (ours["time_s"], ours["stages_s"], ours["pairs"]) == (2.0, {"map": 1.0}, 3)
    assert (ours["fastest_s"], ours["slowest_s"]) == (1.0, 5.0)
    assert (other["time_s"], other["extra_bytes"], ours["extra_bytes"]) == (7.0, 30, None)


def test_of_repeated_runs_the_middle_one_counts_and_all_must_be_right():
    runs = [measurement(10, t, stages_s={"map": t}) for t in (3.0, 1.0, 2.0)]
    assert middle(runs) == runs[2]
    wrong = replace(runs[0], is_right=False)
    assert middle([wrong, *runs[1:]]) == replace(runs[2], is_right=False)
    assert middle(runs[:1]) == runs[0]
    failed = replace(runs[1], is_right=False, error="RuntimeError: out of luck")
    assert middle([runs[0], failed, runs[2]]) == replace(failed, time_s=2.0, stages_s={"map": 2.0})


@pytest.mark.parametrize("family", ["paper_room", "facade"])
def test_scans_have_the_points_that_were_asked_for(family):
    pair = simulate_size(family, 3, 60_000)
    points = len(pair.source_m) + len(pair.target_m)
    assert points == pytest.approx(120_000, rel=0.03)


def test_only_a_pose_within_the_thresholds_is_right_and_an_error_is_wrong(pair):
    off = pair.T_target_source.copy()
    off[0, 3] += 2 * pair.success_translation_m
    about = measurement(20_000, 0.0)
    assert measure(lambda task: Estimate(pair.T_target_source, {}), pair, about).is_right
    assert not measure(lambda task: Estimate(off, {}), pair, about).is_right

    def fail(task):
        raise RuntimeError("out of luck")

    found = measure(fail, pair, about)
    assert (found.is_right, found.error) == (False, "RuntimeError: out of luck")


def test_peak_memory_counts_what_a_method_takes_beyond_its_input(pair):
    # ICP holds both clouds once more, in float64, and a search tree over one.
    large = simulate_pair("paper_room", 1, points=300_000).pair
    extra = peak_bytes(("skipnet.benchmark.methods.icp.make", {"max_iterations": 1}), large, pair)
    assert extra is not None and extra > large.source_m.nbytes + large.target_m.nbytes


def test_a_run_leaves_every_figure_and_keeps_to_the_limits(tmp_path, monkeypatch):
    timed = []

    def remembered(method, pair, about):
        timed.append((about.size, about.seed, about.method))
        return measure(method, pair, about)

    monkeypatch.setattr("skipnet.benchmark.running.speed.measure", remembered)
    config = replace(
        evaluate_options("benchmark=speed", "pairs=2", "methods=[skipnet,icp]"),
        speed=SpeedConfig(
            ["paper_room"], [], SIZES, most_points={"icp": SIZES[0]}, repeats=2, memory=False
        ),
        output_dir=str(tmp_path / "run"),
    )
    told = []
    with listening(lambda *words: told.append(words)):
        summary = run_speed(config)
    assert ("measurements", 0, 6) in told and ("measurements", 6, 6) in told
    run = tmp_path / "run"
    assert {(row["method"], row["size"]) for row in summary["rows"]} == {
        ("skipnet", SIZES[0]),
        ("skipnet", SIZES[1]),
        ("icp", SIZES[0]),
    }
    lines = [json.loads(line) for line in (run / "measurements.jsonl").read_text().splitlines()]
    assert len(lines) == 6, "one line for each pair, method and size, however often it ran"
    turns = [(seed, method) for size, seed, method in timed if size == SIZES[0]]
    there, back = ["skipnet", "icp"], ["icp", "skipnet"]
    assert [method for seed, method in turns if seed == SPEED.first] == there + back
    assert [method for seed, method in turns if seed == SPEED.first + 1] == back + there
    assert all(line["points"] == pytest.approx(2 * line["size"], rel=0.1) for line in lines)
    report = (run / "report.md").read_text()
    assert "ICP directly takes" in report and "| skip-map |" in report
    for title in ("Growth", "Time as a multiple of that of skipnet"):
        assert f"## {title}, paper_room" in report
    assert (run / "figures" / "times.png").read_bytes().startswith(b"\x89PNG")
    with open(run / "scores.csv", encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 3
    assert {"config.yaml", "summary.json", "report.html", "tensorboard"} <= {
        path.name for path in run.iterdir()
    }


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"speed": SpeedConfig(["nosuch"])}, "unknown scene family 'nosuch'"),
        ({"speed": SpeedConfig([], ["rigns"])}, "kind of pair 'rigns'; did you mean 'rings'"),
        ({"methods": "skipnet,icp_from_coarse"}, "starts from the pose of"),
        ({"methods": "icp", "speed": SpeedConfig(points=[9], most_points={"icp": 8})}, "above 8"),
        ({"methods": "skipnet"}, "choose another output_dir"),
    ],
)
def test_what_cannot_be_measured_is_refused_and_earlier_measurements_stay(tmp_path, changed, words):
    changed = dict(changed)
    (tmp_path / "measurements.jsonl").write_text("{}\n")
    methods = changed.pop("methods", "skipnet")
    config = evaluate_options("benchmark=speed", f"methods=[{methods}]", f"output_dir={tmp_path}")
    config = replace(config, **changed)
    with pytest.raises(ValueError, match=words):
        run_speed(config)
    assert (tmp_path / "measurements.jsonl").read_text() == "{}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["measurements.jsonl"]


def test_hard_pairs_have_a_table_and_what_shares_nothing_is_right_when_refused(tmp_path):
    config = replace(
        evaluate_options("benchmark=speed", "pairs=1", "methods=[skipnet,small_gicp]"),
        speed=SpeedConfig([], ["rings", "rings_negative"], repeats=1),
        output_dir=str(tmp_path / "run"),
    )
    rows = run_speed(config)["rows"]
    right = {(row["family"], row["method"]): row["successes"] for row in rows}
    assert right["rings", "skipnet"] == right["rings_negative", "skipnet"] == 1
    assert right["rings_negative", "small_gicp"] == 0, "it has no verdict"
    report = (tmp_path / "run" / "report.md").read_text()
    assert "## Time, hard pairs" in report and "Stages of skipnet, rings_negative" in report


@pytest.mark.parametrize("sizes", [[], [0, 5], [20, 10]])
def test_sizes_must_ascend(sizes):
    with pytest.raises(ValueError, match="speed.points"):
        SpeedConfig(points=sizes)
    assert np.all(np.diff(SpeedConfig().points) > 0)
