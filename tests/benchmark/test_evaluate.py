"""evaluate.py from the command line to the files of a run; methods that are quick stand for all."""

import csv
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from skipnet.benchmark.datasets.dataset import make_dataset
from skipnet.benchmark.datasets.overlapping import KINDS, Overlapping
from skipnet.benchmark.datasets.simulated import Simulated
from skipnet.benchmark.methods import Task, make_method
from skipnet.benchmark.methods.matching import most_consistent_pose
from skipnet.benchmark.options import EvaluateConfig, MethodConfig
from skipnet.benchmark.running.runner import predict
from skipnet.benchmark.running.setup import make_methods, make_pair_set
from skipnet.benchmark.scoring.predictions import read_predictions
from skipnet.commands import hydra_app as command
from skipnet.commands.evaluate import evaluate, main
from skipnet.geometry import make_transform, pose_error, rotation_from_vector, transform_points
from skipnet.metrics.poses import inlier_ratio
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.scenes.scenes import AMBIGUOUS_FAMILIES, FAMILIES
from tests.composing import evaluate_options

ROOT = Path(__file__).parents[2]
BENCHMARKS = sorted(path.stem for path in (ROOT / "configs" / "benchmark").glob("*.yaml"))
SMALL = ("pairs=2", "points=3000", "methods=[small_gicp,kiss_matcher]")
FILES = {
    "config.yaml",
    "predictions.jsonl",
    "scores.csv",
    "summary.json",
    "report.md",
    "report.html",
    "figures",
    "tensorboard",
}


def made_by(module):
    return f"skipnet.benchmark.methods.{module}.make"


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A run of two small simulated rooms."""
    folder = tmp_path_factory.mktemp("run")
    return folder, evaluate(evaluate_options(*SMALL, "worst=1", f"output_dir={folder}"))


def test_a_run_leaves_every_file_and_returns_its_summary(run_folder):
    folder, summary = run_folder
    assert {path.name for path in folder.iterdir()} == FILES
    assert json.loads((folder / "summary.json").read_text()) == json.loads(json.dumps(summary))
    assert [(e["method"], e["stage"], e["pairs"]) for e in summary["rows"]] == [
        ("small_gicp", "fine", 2),
        ("kiss_matcher", "coarse", 2),
        ("kiss_matcher", "fine", 2),
    ]
    assert summary["versions"]["open3d"] != "not installed"
    assert OmegaConf.load(folder / "config.yaml").points == 3000


def test_summary_can_be_recomputed_from_the_csv(run_folder):
    folder, summary = run_folder
    with (folder / "scores.csv").open() as file:
        records = list(csv.DictReader(file))
    assert len(records) == 6
    for entry in summary["rows"]:
        chosen = [
            r for r in records if (r["method"], r["stage"]) == (entry["method"], entry["stage"])
        ]
        errors_mm = [float(record["mean_error_mm"]) for record in chosen]
        assert entry["median"]["mean_error_mm"] == pytest.approx(np.median(errors_mm))
        assert entry["successes"] == sum(record["success"] == "True" for record in chosen)


def test_report_stands_beside_the_paper_and_opens_offline(run_folder):
    folder, _ = run_folder
    text = (folder / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert text.count("data:image/png;base64,") == len(list((folder / "figures").iterdir()))
    for linked in re.findall(r"\]\((figures/[^)]+)\)", (folder / "report.md").read_text()):
        assert (folder / linked).is_file()


def test_tensorboard_holds_curves_tables_and_pictures(run_folder):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    folder, summary = run_folder
    tags = EventAccumulator(str(folder / "tensorboard")).Reload().Tags()
    assert {f"figures/{path.stem}" for path in (folder / "figures").iterdir()} <= set(
        tags["images"]
    )
    assert any("Success, error and time" in tag for tag in tags["tensors"])
    # Each method is a run of its own under the same tags, so that one chart holds them all.
    for entry in summary["rows"]:
        events = EventAccumulator(str(folder / "tensorboard" / entry["method"])).Reload()
        assert [point.step for point in events.Scalars("3 pairs/mean_error_mm")] == [0, 1]
        hparams = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
        for option in (b"time_limit_s", b"rotation", b"speed.repeats", b"method_options.make"):
            assert option in hparams
        group = "1 result" if entry["stage"] == "fine" else "4 coarse"
        (rate,) = events.Scalars(f"{group}/1 success rate")
        assert rate.value == pytest.approx(entry["success_rate"])
        curve = events.Scalars("2 curves/share of pairs within step mm")
        assert (curve[0].step, curve[-1].step) == (10, 10_000)
        assert all(low.value <= high.value for low, high in zip(curve, curve[1:], strict=False))


def test_the_paper_stands_under_the_rows_it_has():
    from skipnet.benchmark.reporting.tables import PAPER_TABLE_2, table_2

    values = {"time_s": 1.0, "map_s": 0.9, "transform_s": 0.1, "mean_error_mm": 2.0}
    entries = [
        {"method": m, "stage": s, "label": m, "successes": 1, "pairs": 1, "median": values}
        for m, s in [*PAPER_TABLE_2, ("kiss_matcher", "fine")]
    ]
    table = table_2(entries, with_paper=True)
    assert [row[0] for row in table.rows] == [
        "skipnet", "in the paper", "skipnet", "in the paper", "icp", "in the paper", "kiss_matcher"
    ]  # fmt: skip
    cells = dict(zip(table.headers, table.rows[1], strict=True))
    assert (cells["time (s)"], cells["mean (mm)"]) == ("40.4", "42.9")
    for figures in PAPER_TABLE_2.values():  # the paper's own means are those of its axes
        axes_mm = [figures[f"{axis}_error_mm"] for axis in "xyz"]
        assert figures["mean_error_mm"] == pytest.approx(np.mean(axes_mm), abs=0.01)


@pytest.mark.parametrize("benchmark", BENCHMARKS)
def test_every_benchmark_config_composes_and_its_methods_can_be_built(benchmark, tmp_path):
    config = evaluate_options(f"benchmark={benchmark}", f"output_dir={tmp_path}")
    assert config.benchmark == benchmark
    assert [method.name for method in make_methods(config)] == list(config.methods)
    dataset = make_dataset(config)
    if isinstance(dataset, Simulated):
        conditions = max(len(config.disturbances), 1)
        unique = len(FAMILIES) - len(AMBIGUOUS_FAMILIES)
        families = unique if config.family == "all" else 1
        assert len(make_pair_set(config)) == config.pairs * conditions * families
    elif isinstance(dataset, Overlapping):
        assert len(make_pair_set(config)) == config.pairs * len(KINDS)
    else:
        with pytest.raises(FileNotFoundError, match="data=FOLDER"):
            make_pair_set(config)


@pytest.mark.parametrize(
    ("module", "options"),
    [
        ("icp", {"max_distance_m": 0.5}),
        ("icp", {"max_distance_m": 0.5, "to_planes": True}),
        ("icp", {"max_distance_m": 0.5, "to_planes": True, "thin": True}),
        ("small_gicp", {}),
        ("open3d", {"max_iterations": 5000}),
        ("open3d", {"search": "fgr"}),
        ("matching", {}),
        ("matching", {"descriptor": "learned"}),
        ("kiss_matcher", {}),
        ("kiss_matcher", {"fine": False}),
    ],
)
def test_a_method_answers_and_a_local_one_stays_at_the_truth(module, options):
    pair = simulate_pair("paper_room", 1, points=20_000).pair
    estimate = make_method(made_by(module), options)(
        Task(pair.source_m, pair.target_m, T_target_source_start=pair.T_target_source)
    )
    assert set(estimate.stage_s) <= {"map", "transform", "fine"}
    assert estimate.T_target_source.shape == (4, 4)
    if module in ("icp", "small_gicp"):
        rotation_error_rad, translation_error_m = pose_error(
            estimate.T_target_source, pair.T_target_source
        )
        assert rotation_error_rad < np.deg2rad(0.5)
        assert translation_error_m < 0.03


def test_skipnet_splits_its_time_as_the_paper_does():
    from skipnet.benchmark.methods.ours import FINE_STAGES, TRANSFORM_STAGES

    pair = simulate_pair("paper_room", 1, points=20_000).pair
    estimate = make_method(made_by("ours"), {"generators": ["planes"]})(
        Task(pair.source_m, pair.target_m)
    )
    # A stage that registration renamed would silently count as map.
    assert {*TRANSFORM_STAGES, *FINE_STAGES} <= set(estimate.timings_s)
    fine_s = sum(estimate.timings_s[stage] for stage in FINE_STAGES)
    assert estimate.stage_s["fine"] == pytest.approx(fine_s)
    assert sum(estimate.stage_s.values()) >= sum(estimate.timings_s.values())
    assert estimate.T_target_source_coarse is not None


def test_icp_brings_back_a_small_motion_exactly():
    points_m = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    T_true = make_transform(
        rotation_from_vector(np.array([0.01, 0.0, 0.02])), np.array([0.01, 0, 0])
    )
    source_m = (points_m - T_true[:3, 3]) @ T_true[:3, :3]
    estimate = make_method(made_by("icp"))(Task(source_m, points_m))
    assert pose_error(estimate.T_target_source, T_true) == pytest.approx((0, 0), abs=1e-6)


def test_icp_to_planes_brings_back_a_small_motion():
    rng = np.random.default_rng(0)
    walls_m = [np.insert(rng.uniform(-1, 1, (2000, 2)), axis, 1.0, axis=1) for axis in range(3)]
    points_m = np.concatenate(walls_m)
    T_true = make_transform(
        rotation_from_vector(np.array([0.01, 0.0, 0.02])), np.array([0.01, 0, 0])
    )
    source_m = (points_m - T_true[:3, 3]) @ T_true[:3, :3]
    estimate = make_method(made_by("icp"), {"to_planes": True, "max_distance_m": 0.2})(
        Task(source_m, points_m)
    )
    assert pose_error(estimate.T_target_source, T_true) == pytest.approx((0, 0), abs=1e-3)


def test_most_consistent_pose_survives_wrong_correspondences():
    rng = np.random.default_rng(0)
    T_true = make_transform(rotation_from_vector(np.array([0.5, 1.0, -0.7])), np.array([1.0, 2, 3]))
    source_m = rng.uniform(-3, 3, (60, 3))
    target_m = transform_points(T_true, source_m)
    target_m[20:] = rng.uniform(-3, 3, (40, 3))  # two of three are wrong
    pose, inliers = most_consistent_pose(source_m, target_m, 0.05)
    assert pose_error(pose, T_true) == pytest.approx((0, 0), abs=1e-6)
    assert inliers >= 20
    with pytest.raises(ValueError, match="no three of 2"):
        most_consistent_pose(source_m[:2], target_m[:2], 0.05)


@pytest.mark.parametrize("descriptor", ["fpfh", "learned"])
def test_matching_hands_out_its_correspondences(descriptor):
    pair = simulate_pair("paper_room", 1, points=20_000).pair
    viewpoints_m = pair.source_viewpoint_m, pair.target_viewpoint_m
    estimate = make_method(made_by("matching"), {"descriptor": descriptor})(
        Task(pair.source_m, pair.target_m, *viewpoints_m)
    )
    source_m, target_m = estimate.correspondences
    assert source_m.shape == target_m.shape == (len(source_m), 3)
    low_m, high_m = pair.target_m.min(axis=0), pair.target_m.max(axis=0)
    assert ((target_m >= low_m) & (target_m <= high_m)).all()
    # By chance, one in thousands would lie within 0.3 m of its partner.
    assert inlier_ratio(source_m, target_m, pair.T_target_source, 0.3) > 0.02


def test_the_same_run_twice_gives_the_same_answers(tmp_path):
    """RANSAC too, which draws at random, and whose threads would race."""
    methods = ["skipnet", "fpfh_ransac", "fgr", "kiss_matcher"]
    config = evaluate_options("pairs=1", "points=3000", f"methods=[{','.join(methods)}]")
    answers = []
    for name in ("first.jsonl", "second.jsonl"):
        predict(make_pair_set(config), make_methods(config), tmp_path / name)
        answers.append([p.T_target_source for p in read_predictions(tmp_path / name)])
    assert len(answers[0]) == len(methods) and None not in answers[0]
    assert answers[0] == answers[1]


def test_answers_are_judged_anew_by_another_protocol(run_folder, tmp_path):
    folder, before = run_folder
    copied = tmp_path / "run"
    shutil.copytree(folder, copied)
    answered = (copied / "predictions.jsonl").read_bytes()
    after = evaluate(evaluate_options(*SMALL, "protocol=deg5_2m", f"output_dir={copied}"))
    assert (copied / "predictions.jsonl").read_bytes() == answered
    assert "5°, 2 m" in after["about"]["protocol"]
    successes = [[entry["successes"] for entry in one["rows"]] for one in (before, after)]
    assert all(loose >= strict for strict, loose in zip(*successes, strict=True))


def test_a_killed_run_goes_on_and_keeps_what_it_had(tmp_path):
    """A real SIGKILL, in the middle of the pairs."""
    folder = tmp_path / "run"
    command = [sys.executable, "evaluate.py", "benchmark=simulated", "methods=[small_gicp]"]
    command += ["pairs=12", "points=2000", "worst=0", f"output_dir={folder}"]
    predictions = folder / "predictions.jsonl"
    process = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not predictions.exists() or predictions.read_bytes().count(b"\n") < 2:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait()
    before = predictions.read_bytes()
    before = before[: before.rfind(b"\n") + 1]
    assert 2 <= before.count(b"\n") < 12
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "pairs were answered before" in done.stderr
    after = predictions.read_bytes()
    assert after.startswith(before)
    names = [json.loads(line)["pair"] for line in after.splitlines()]
    assert len(names) == len(set(names)) == 12


def test_an_absent_data_set_is_one_line_and_exit_code_2(tmp_path, capsys):
    arguments = ["benchmark=3dmatch", f"data={tmp_path}", f"output_dir={tmp_path / 'run'}"]
    code = command.run("evaluate", EvaluateConfig, evaluate, arguments=arguments)
    message = capsys.readouterr().err
    assert (code, message.count("\n")) == (2, 1)
    assert "https://3dmatch.cs.princeton.edu" in message
    assert not (tmp_path / "run").exists()


def test_a_missing_package_stops_with_the_pip_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_matcher", None)
    with pytest.raises(ImportError, match="pip install kiss-matcher"):
        make_method(made_by("kiss_matcher"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": {"icp": {"make": "a.b", "start_from": "skipnet"}}}, "put skipnet before it"),
        ({"threads": 0}, "threads=0"),
        ({"most_per_set": 0}, "most_per_set=0"),
        ({"inlier_distance_m": 0.0}, "inlier_distance_m"),
        ({"disturbances": [{"name": "a"}, {"name": "a"}]}, "different names"),
        ({"disturbances": [{"keep": 0.0}]}, "keep=0"),
        ({"disturbances": [{"crop": 1.0}]}, "crop=1"),
        ({"pairs": 0}, "pairs=0"),
        ({"time_limit_s": -1.0}, "time_limit_s"),
    ],
)
def test_settings_that_do_not_fit_say_what_to_do(options, message):
    with pytest.raises(ValueError, match=message):
        OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(EvaluateConfig), options))


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (("gicp", {}), "make=skipnet.benchmark.methods.gicp.make: expected package.module.name"),
        (("icp", {"max_distance": 1.0}), "max_distance.*max_distance_m"),
        (("ours", {"generator": ["planes"]}), "generator"),
        (("ours", {"generators": ["walls"]}), "walls"),
        (("kiss_matcher", {"voxel_size_m": 0.001}), "0.005"),
        (("open3d", {"search": "fgrr"}), "ransac, fgr"),
        (("matching", {"descriptor": "shot"}), "fpfh, learned"),
    ],
)
def test_unknown_methods_and_options_are_named(method, message):
    module, options = method
    config = EvaluateConfig(methods={"it": MethodConfig(made_by(module), options=options)})
    with pytest.raises(ValueError, match=message):
        make_methods(config)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["methods=[skipnett]"], "no such choice: methods=skipnett"),
        (["methods=[icp_from_coarse]"], "put skipnet before it"),
        (["methods=[]"], "no such choice: methods=;"),
        (["dataset=kity"], "no such choice: dataset=kity"),
        (["seed=9980"], "benchmark: 40 scenes from number 9980"),
    ],
)
def test_a_wrong_choice_is_one_line_and_exit_code_2(arguments, message, capsys, tmp_path):
    code = main([*arguments, f"output_dir={tmp_path / 'run'}"])
    error = capsys.readouterr().err
    assert (code, error.count("\n")) == (2, 1) and message in error
    assert not (tmp_path / "run").exists()


def test_a_method_and_a_data_set_of_ones_own_need_no_change_here(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MINE)
    for group, text in MINE_YAML.items():
        (tmp_path / group).mkdir()
        (tmp_path / group / "mine.yaml").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    monkeypatch.chdir(tmp_path)
    options = ["dataset=mine", "methods=[mine]", "worst=0", "output_dir=run"]
    assert main(["--config-dir", str(tmp_path), *options]) == 0
    summary = json.loads(Path("run", "summary.json").read_text())
    (entry,) = summary["rows"]
    assert (entry["label"], entry["pairs"], entry["successes"]) == ("it stays", 1, 0)
    assert entry["median"]["translation_error_mm"] == pytest.approx(500)
    assert summary["about"]["pairs from"] == "one cloud"


MINE_YAML = {
    "dataset": "# @package _global_\ndataset: mine.OneCloud\n",
    "methods": "mine: {make: mine.make, label: it stays, options: {shift_m: 0.5}}\n",
}
MINE = """
from dataclasses import dataclass
import numpy as np
from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.methods import Estimate
from skipnet.benchmark.options import EvaluateConfig, ProtocolKind
from skipnet.types import Pair

@dataclass(frozen=True)
class OneCloud:
    config: EvaluateConfig
    protocol = ProtocolKind.own

    def pairs(self):
        cloud_m = np.random.default_rng(self.config.seed).uniform(0, 3, (3000, 3))
        return PairSet(("one",), lambda index: Pair("one", "mine", cloud_m, cloud_m, np.eye(4)))

    def describe(self):
        return {"pairs from": "one cloud"}

    def key(self):
        return ["one cloud", self.config.seed]

def make(shift_m=0.0):
    T = np.eye(4)
    T[0, 3] = shift_m
    return lambda task: Estimate(T, {"fine": 0.01})
"""


def test_a_run_without_methods_is_refused(tmp_path):
    with pytest.raises(ValueError, match="methods=.*at least one"):
        evaluate(EvaluateConfig(output_dir=str(tmp_path / "run")))


def test_misspelt_option_is_one_line_and_exit_code_2(capsys):
    code = command.run("evaluate", EvaluateConfig, evaluate, arguments=["pair=3"])
    assert code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_option_of_the_wrong_kind_is_refused_by_name():
    with pytest.raises(ValueError, match="icp.make cannot take .*max_iterations"):
        make_method(made_by("icp"), {"max_iterations": "abc"})


def test_help_is_instant_in_that_it_imports_nothing_heavy():
    script = (
        "import sys; from skipnet.commands import evaluate; "
        "evaluate.main(['pair=3']); "
        "print([m for m in ('torch', 'open3d', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
