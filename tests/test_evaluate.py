"""evaluate.py from the command line to the files of a run; methods that are quick stand for all."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

import evaluate
from skipnet import command
from skipnet.benchmark.methods import Task, make_method
from skipnet.benchmark.runner import make_contestants, make_pair_set
from skipnet.config import EvaluateConfig, VariantConfig
from skipnet.geometry import make_transform, pose_error, rotation_from_vector
from skipnet.simulation.pairs import simulate_pair

ROOT = Path(__file__).parent.parent
BENCHMARKS = sorted(path.stem for path in (ROOT / "configs" / "benchmark").glob("*.yaml"))
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


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A run of two small simulated rooms."""
    folder = tmp_path_factory.mktemp("run")
    summary = evaluate.main(
        EvaluateConfig(
            pairs=2, points=3000, methods=["small_gicp", "kiss_matcher"], output_dir=str(folder)
        )
    )
    return folder, summary


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
    events = EventAccumulator(str(folder / "tensorboard")).Reload()
    tags = events.Tags()
    curve = events.Scalars("mean_error_mm by pair/small_gicp_fine")
    assert [point.step for point in curve] == [0, 1]
    (rate,) = events.Scalars("success_rate/small_gicp_fine")
    assert rate.value == pytest.approx(summary["rows"][0]["success_rate"])
    assert {f"figures/{path.stem}" for path in (folder / "figures").iterdir()} <= set(
        tags["images"]
    )
    assert any("Time and error" in tag for tag in tags["tensors"])


def test_the_paper_stands_under_the_rows_it_has():
    from skipnet.benchmark.tables import PAPER_TABLE_2, table_2

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
    ConfigStore.instance().store(name="evaluate_schema", node=EvaluateConfig)
    overrides = [f"benchmark={benchmark}", f"output_dir={tmp_path}"]
    if benchmark == "folder":
        overrides.append(f"data={tmp_path}")
    with initialize_config_dir(str(ROOT / "configs"), version_base="1.3"):
        config = OmegaConf.to_object(compose("evaluate", overrides))
    assert config.benchmark == benchmark
    assert [c.name for c in make_contestants(config)] == config.methods
    if benchmark != "folder":
        assert len(make_pair_set(config)) == config.pairs


@pytest.mark.parametrize(
    ("adapter", "options"),
    [
        ("icp", {"max_distance_m": 0.5}),
        ("small_gicp", {}),
        ("open3d", {"max_iterations": 5000}),
        ("kiss_matcher", {}),
    ],
)
def test_a_method_stays_at_the_truth_when_it_starts_there(adapter, options):
    pair = simulate_pair("paper_room", 1, points=20_000).pair
    estimate = make_method(adapter, options)(
        Task(pair.source_m, pair.target_m, T_target_source_start=pair.T_target_source)
    )
    assert set(estimate.stage_s) <= {"map", "transform", "fine"}
    assert estimate.T_target_source.shape == (4, 4)
    if adapter in ("icp", "small_gicp"):
        rotation_error_rad, translation_error_m = pose_error(
            estimate.T_target_source, pair.T_target_source
        )
        assert rotation_error_rad < np.deg2rad(0.5)
        assert translation_error_m < 0.03


def test_skipnet_splits_its_time_as_the_paper_does():
    from skipnet.benchmark.methods.ours import FINE_STAGES, TRANSFORM_STAGES

    pair = simulate_pair("paper_room", 1, points=20_000).pair
    estimate = make_method("skipnet", {"generators": ["planes"]})(
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
    estimate = make_method("icp")(Task(source_m, points_m))
    assert pose_error(estimate.T_target_source, T_true) == pytest.approx((0, 0), abs=1e-6)


def test_a_missing_package_stops_with_the_pip_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_matcher", None)
    with pytest.raises(ImportError, match="pip install kiss-matcher"):
        make_method("kiss_matcher")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"methods": ["skipnett"]}, "unknown method 'skipnett'"),
        ({"methods": []}, "at least one"),
        ({"methods": ["icp_from_coarse"]}, "put skipnet before it"),
        ({"dataset": "folder"}, "data=FOLDER"),
        ({"pairs": 0}, "pairs=0"),
        ({"time_limit_s": -1.0}, "time_limit_s"),
    ],
)
def test_settings_that_do_not_fit_say_what_to_do(options, message):
    with pytest.raises(ValueError, match=message):
        OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(EvaluateConfig), options))


@pytest.mark.parametrize(
    ("variant", "message"),
    [
        (VariantConfig("gicp"), "gicp.*small_gicp"),
        (VariantConfig("icp", options={"max_distance": 1.0}), "max_distance.*max_distance_m"),
        (VariantConfig("skipnet", options={"generator": ["planes"]}), "generator"),
        (VariantConfig("skipnet", options={"generators": ["walls"]}), "walls"),
        (VariantConfig("kiss_matcher", options={"voxel_size_m": 0.001}), "0.005"),
    ],
)
def test_unknown_adapters_and_options_are_named(variant, message):
    config = EvaluateConfig(methods=["icp"], variants={"icp": variant})
    with pytest.raises(ValueError, match=message):
        make_contestants(config)


def test_misspelt_option_is_one_line_and_exit_code_2(capsys):
    code = command.run(
        "evaluate", EvaluateConfig, evaluate.main, evaluate.CONFIG_DIR, arguments=["pair=3"]
    )
    assert code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_help_is_instant_in_that_it_imports_nothing_heavy():
    script = (
        "import sys, evaluate; from skipnet import command; "
        "command.run('evaluate', evaluate.EvaluateConfig, evaluate.main, evaluate.CONFIG_DIR, "
        "arguments=['pair=3']); "
        "print([m for m in ('torch', 'open3d', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "[]"
