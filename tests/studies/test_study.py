"""What studies share: jobs done once, a report like the benchmark's, one-line errors."""

from __future__ import annotations

import json

import pytest

from skipnet.benchmark.datasets.overlapping import KINDS
from skipnet.commands.study import main
from skipnet.simulation.situations.catalog import SITUATIONS
from skipnet.studies import accuracy, calibration
from skipnet.studies.calibration import error_of
from skipnet.studies.options import STUDIES, AccuracyConfig, StudyConfig
from skipnet.studies.study import OUTCOMES_FILE, do_all, report
from skipnet.studies.trials import FAMILIES, SCANNERS, Trial, trials_of_scene
from skipnet.viz.tables import Table


def test_jobs_are_done_once_and_come_back_in_order(tmp_path):
    done = []

    def double(number):
        done.append(number)
        return {"twice": 2 * number}

    assert do_all({"b": 2, "a": 1}, double, tmp_path) == [{"twice": 4}, {"twice": 2}]
    again = do_all({"a": 1, "c": 3, "b": 2}, double, tmp_path)
    assert again == [{"twice": 2}, {"twice": 6}, {"twice": 4}]
    assert done == [2, 1, 3]


def test_a_killed_study_goes_on_where_it_stopped(tmp_path):
    def killed(number):
        if number == 2:
            raise KeyboardInterrupt
        return {"is": number}

    with pytest.raises(KeyboardInterrupt):
        do_all({"one": 1, "two": 2}, killed, tmp_path)
    with open(tmp_path / OUTCOMES_FILE, "a") as file:
        file.write('{"job": "two", "out')  # a line cut off
    outcomes = do_all({"one": None, "two": 2}, lambda number: {"is": number}, tmp_path)
    assert outcomes == [{"is": 1}, {"is": 2}]


def test_outcomes_of_another_version_are_refused(tmp_path):
    line = {"job": "a", "maker": "0.0.0-0123", "outcome": {}}
    (tmp_path / OUTCOMES_FILE).write_text(json.dumps(line) + "\n")
    with pytest.raises(ValueError, match="0.0.0-0123.*choose another output_dir"):
        do_all({"a": 1}, lambda number: {}, tmp_path)


def test_a_report_has_the_files_of_a_benchmark(tmp_path, capsys):
    config = StudyConfig(output_dir=str(tmp_path / "run"))
    table = Table("Counts", ("", "right"), (("rooms", "3 of 4"),))
    summary = report(config, "A question", {"scans": "four"}, [table], sentences=["So."], right=3)
    files = {path.name for path in (tmp_path / "run").iterdir()}
    assert files == {"config.yaml", "summary.json", "report.md", "report.html"}
    assert json.loads((tmp_path / "run" / "summary.json").read_text()) == summary
    assert summary["right"] == 3 and summary["about"] == {"scans": "four"}
    for name in ("report.md", "report.html"):
        assert {"A question", "3 of 4", "So."} <= {
            text
            for text in ("A question", "3 of 4", "So.")
            if text in (tmp_path / "run" / name).read_text()
        }
    assert "| rooms | 3 of 4 |" in capsys.readouterr().out


def test_accuracy_takes_up_where_it_was_and_reports_medians(tmp_path, monkeypatch):
    tried = []

    def off(job):
        tried.append(job)
        return {"bound": 1.0, "skipnet": 2.0 + len(tried) % 2, "gicp": 4.0}

    monkeypatch.setattr(accuracy, "try_pair", off)
    config = AccuracyConfig(pairs=1, workers=1, output_dir=str(tmp_path))
    accuracy.run(config)
    summary = accuracy.run(AccuracyConfig(pairs=2, workers=1, output_dir=str(tmp_path)))
    assert len(tried) == 2 * len(accuracy.FAMILIES)
    assert summary["medians_mm"]["oblique"] == {"bound": 1.0, "skipnet": 2.5, "gicp": 4.0}


def test_a_calibration_has_every_family_and_scanner_and_both_answers():
    jobs = calibration.jobs(2)
    kinds = len(FAMILIES) * len(SCANNERS) + len(KINDS)
    assert len(jobs) == 2 * kinds + 4 * len(SITUATIONS)
    trials = trials_of_scene("oblique", "terrestrial", 0)
    assert {trial.name.split("/")[-1] for trial in trials} <= {"same", "different"}
    right = [trial for trial in trials if trial.right]
    assert right and all(trial.name.endswith("same") for trial in right)
    again = [Trial.from_json(json.loads(json.dumps(trial.as_json))) for trial in trials]
    assert [trial.as_json for trial in again] == [trial.as_json for trial in trials]
    fitted = calibration.fit(trials)
    assert 0 <= error_of(fitted, trials) < 0.5


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_help_with_its_options(name, capsys):
    assert main([name, "--help"]) == 0
    printed = capsys.readouterr().out
    assert f"skipnet study {name}" in printed
    assert "seed: 0" in printed and "output_dir: " in printed


def test_the_list_of_studies_is_the_help(capsys):
    assert main(["--help"]) == main([]) == 0
    assert all(f"skipnet study {name}" in capsys.readouterr().out for name in [*STUDIES][:1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["vigilanc"], "did you mean 'vigilance'"),
        (["vigilance", "pair=3"], "did you mean pairs?"),
        (["vigilance", "pairs=-1"], "pairs=-1: expected 0 or more"),
        (["vigilance", "pairs=2000"], "vigilance: 2000 scenes from number 0 on"),
        (["accuracy", "seed=-1"], "seed=-1"),
        (["misses"], "run=FOLDER"),
        (["inliers"], "data=FOLDER"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
