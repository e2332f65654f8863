"""Results save, show and draw themselves; the closing table; lengths in the unit of the files."""

from __future__ import annotations

import json

import numpy as np
import pytest

import skipnet
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import transform_points
from skipnet.registration.prior import Prior
from skipnet.results import files, saving
from skipnet.results.closing import closing_rows
from skipnet.results.priors import read_pose
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.viz.lengths import Lengths

FEET_M = 0.3048


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=20_000).pair


@pytest.fixture(scope="module")
def result(pair):
    numbered = np.column_stack([pair.source_m, np.arange(len(pair.source_m))])
    return skipnet.register(numbered, pair.target_m)


def test_a_result_saves_what_the_command_line_writes(tmp_path, result, pair):
    result.save(tmp_path / "out", format="laz")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"result.json", "aligned.ply", "aligned.laz", "report.html"}
    aligned = skipnet.read_cloud(tmp_path / "out" / "aligned.ply")
    expected_m = transform_points(result.T_target_source, pair.source_m)
    np.testing.assert_allclose(aligned.points_m, expected_m)
    assert aligned.columns["column_4"].tolist() == list(range(len(aligned)))


def test_a_result_draws_itself_in_a_notebook_and_in_a_browser(result, monkeypatch):
    assert "iframe" in result._repr_html_() and "webgl" in result._repr_html_()
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    page = result.show()
    assert opened[0].endswith("report.html") and page.endswith("report.html")


def test_a_result_of_a_pair_among_many_says_that_it_holds_no_scans(pair):
    many = skipnet.register_many([pair.source_m, pair.target_m])
    assert str(many).startswith(f"{many.outcome}: ") and repr(many) == f"<Assembly {many}>"
    assert "curvature" in many._repr_html_() and "residual" in many._repr_html_()
    assert "iframe" in many._repr_html_()
    with pytest.raises(ValueError, match="of a pair among many"):
        many.pairs[0, 1].save("nowhere")


def test_many_scans_are_saved(tmp_path, pair):
    many = skipnet.register_many([pair.source_m, pair.target_m])
    many.save(tmp_path)
    poses = json.loads((tmp_path / "poses.json").read_text())
    assert poses["status"] == many.outcome and (tmp_path / "merged.ply").exists()


def test_what_was_given_comes_back_moved_in_its_own_kind(result, pair):
    T = result.T_target_source
    expected_m = transform_points(T, pair.source_m)
    wide = np.column_stack([pair.source_m, np.arange(len(pair.source_m))])
    np.testing.assert_allclose(result.transform(wide)[:, :3], expected_m)
    np.testing.assert_array_equal(result.transform(wide)[:, 3], wide[:, 3])
    assert isinstance(result.transform(skipnet.Cloud(pair.source_m)), skipnet.Cloud)


def test_the_closing_table_names_what_matters(result):
    rows = dict(closing_rows(result, np.full(100, 0.001), Lengths(), ["a.ply"]))
    assert list(rows) == ["verdict", "overlap", "residual", "uncertainty", "time", "files"]
    assert rows["residual"].startswith("1 mm") and rows["files"] == "a.ply"


def test_files_in_feet_are_reported_in_feet_and_inches(tmp_path, pair, capsys):
    for name, points_m in (("a", pair.source_m), ("b", pair.target_m)):
        write_cloud(tmp_path / f"{name}.ply", points_m / FEET_M)
    choices = files.Choices(unit="ft", prior=Prior(pair.T_target_source))
    out = tmp_path / "out"
    result = files.register_pair_files(tmp_path / "a.ply", tmp_path / "b.ply", out, choices)
    told = capsys.readouterr().out
    assert " in to the nearest point" in told and "within what the prior allows" in told
    found = json.loads((out / "result.json").read_text())
    in_feet = np.array(found["T_target_source_in_unit"])
    np.testing.assert_allclose(in_feet[:3, 3] * FEET_M, result.T_target_source[:3, 3])
    assert found["unit"] == "ft" and "The same in ft" in (out / "report.html").read_text()


def test_a_pose_is_read_from_rows_text_and_results(tmp_path):
    T = np.eye(4)
    T[:3, 3] = [1, 2, 3]
    np.savetxt(tmp_path / "a.txt", T)
    (tmp_path / "b.json").write_text(json.dumps({"T_target_source": T.tolist()}))
    for given in (T.tolist(), str(tmp_path / "a.txt"), str(tmp_path / "b.json")):
        np.testing.assert_array_equal(read_pose(given), T)
    (tmp_path / "c.json").write_text('{"pose": 1}')
    with pytest.raises(ValueError, match=r"c.json: holds no pose"):
        read_pose(str(tmp_path / "c.json"))


def test_the_skip_maps_of_a_page_lie_where_the_scans_do(result, pair):
    from skipnet.results.skipmaps import matched_features, skipmaps_of

    source, target = skipmaps_of(result)
    assert np.abs(source.centroids_m.mean(axis=0) - pair.source_m.mean(axis=0)).max() < 2
    matches = matched_features((source, target), result)
    marks = [one.centroids_m[one.classes < 4] for one in (source, target)]
    moved_m = transform_points(result.T_target_source, marks[0])
    away_m = [np.linalg.norm(moved_m[a] - marks[1][b]) for a, b in matches]
    assert len(matches) > 10 and max(away_m) < 1.5 * result.voxel_size_m
    assert saving.notebook_html(result).count("curvature") > 0


def test_a_laz_pair_on_a_map_gets_the_verdict_of_its_local_coordinates(tmp_path, pair):
    pytest.importorskip("laspy")
    far_m = np.array([500_000.0, 5_400_000.0, 100.0])
    rounded = [np.round(points_m, 4) for points_m in (pair.source_m, pair.target_m)]
    for name, points_m in zip("ab", rounded, strict=True):
        write_cloud(tmp_path / f"{name}.laz", skipnet.Cloud(points_m + far_m, offset_m=far_m))
    local = skipnet.register(*rounded)
    there = skipnet.register(tmp_path / "a.laz", tmp_path / "b.laz")
    moved_m = transform_points(there.T_target_source, rounded[0] + far_m) - far_m
    local_m = transform_points(local.T_target_source, rounded[0])
    np.testing.assert_allclose(moved_m, local_m, atol=1e-4)
    assert there.status == local.status and abs(there.confidence - local.confidence) < 0.01
