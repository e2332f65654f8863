"""Why a pair was missed: the table tells a pose nobody proposed from one that fits less well."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.running.runner import PREDICTIONS_FILE
from skipnet.benchmark.running.setup import make_pair_set
from skipnet.benchmark.scoring.predictions import Prediction, append_prediction
from skipnet.geometry import make_transform
from skipnet.storage import write_config
from skipnet.studies.misses import HEADERS, find_misses, run
from skipnet.studies.options import MissesConfig


def run_folder(folder, shift_m):
    """A run on one simulated room, answered with the truth shifted along x."""
    config = EvaluateConfig(family="oblique", pairs=1, points=20_000, output_dir=str(folder))
    write_config(config, folder / "config.yaml")
    pair = make_pair_set(config).load(0)
    shift = make_transform(np.eye(3), np.array([shift_m, 0.0, 0.0]))
    pose = (shift @ pair.T_target_source).tolist()
    answer = Prediction(pair.name, "skipnet", "", 1.0, T_target_source=pose, status="registered")
    append_prediction(folder / PREDICTIONS_FILE, answer)
    return pair


def test_a_miss_that_the_judge_would_have_seen(tmp_path):
    pair = run_folder(tmp_path, 1.0)
    (miss,) = find_misses(tmp_path)
    assert miss.pair.name == pair.name
    assert miss.was_offered_too_little
    assert 0 < miss.inliers <= miss.correspondences
    reference, answer = miss.score.total
    assert reference > 2 * answer
    assert len(miss.row) == len(HEADERS)
    assert miss.row[-1] == "not proposed"
    titles = [view.title for row in miss.draw().rows for view in row]
    assert titles[:2] == ["reference, from above", "answer, from above"]


def test_right_answers_are_no_misses(tmp_path):
    run_folder(tmp_path, 0.001)
    assert list(find_misses(tmp_path)) == []


def test_the_command_writes_a_picture_and_a_line_for_each(tmp_path, capsys):
    pair = run_folder(tmp_path, 1.0)
    summary = run(MissesConfig(run=str(tmp_path), output_dir=str(tmp_path / "misses")))
    assert [path.stem for path in (tmp_path / "misses" / "figures").iterdir()] == [pair.name]
    page = (tmp_path / "misses" / "report.html").read_text()
    assert page.count('class="viewer"') == 1 and "residual" in page and "truth" in page
    assert capsys.readouterr().out.count(pair.name) == 1
    assert [miss["why"] for miss in summary["misses"]] == ["not proposed"]


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no run of evaluate.py"):
        list(find_misses(tmp_path))


def test_a_run_of_other_methods_is_refused(tmp_path):
    run_folder(tmp_path, 1.0)
    with pytest.raises(ValueError, match="no answers of icp"):
        list(find_misses(tmp_path, "icp"))
