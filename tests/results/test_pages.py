"""What report.html says: a refused pose is never the motion found."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.reading import read_cloud, read_scans
from skipnet.clouds.formats.writing import write_cloud, write_scans
from skipnet.geometry import make_transform, transform_points
from skipnet.registration.pipeline import register
from skipnet.results import files
from skipnet.results.inputs import find_scans, read_given
from skipnet.results.many import register_scan_files
from skipnet.results.views import words_of
from skipnet.simulation.scanning.pairs import simulate_pair

UTM_M = [500_000.0, 5_400_000.0, 100.0]


def page_of(folder):
    return (folder / "report.html").read_text()


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=40_000).pair


def coloured(points_m):
    count = len(points_m)
    colour = np.random.default_rng(0).integers(0, 256, (count, 3)).astype(np.uint8)
    return Cloud(points_m, colour=colour, columns={"label": np.arange(count, dtype=np.int32)})


def test_a_failure_is_called_one_and_says_what_to_try(tmp_path):
    rng = np.random.default_rng(0)
    for name in "ab":
        write_cloud(tmp_path / f"{name}.ply", rng.normal(size=(3000, 3)))
    result = files.register_pair_files(
        tmp_path / "a.ply", tmp_path / "b.ply", tmp_path / "out", files.Choices()
    )
    assert result.status != "registered"
    page = page_of(tmp_path / "out")
    assert "motion found" not in page.lower().replace("no motion found", "")
    assert "What to try" in page and "one more scan between" in page
    assert words_of(result).heading in page and words_of(result).button in page


def test_of_many_alternatives_the_first_have_a_button(pair):
    result = register(pair.source_m, pair.target_m)
    others = tuple(np.eye(4) for _ in range(26))
    many = replace(result, findings=replace(result.findings, alternatives=others))
    page = many._repr_html_()
    assert page.count("alternative 8") == 1 and "alternative 9" not in page
    assert "of 26, of which the first 8 are shown" in page


def test_a_utm_laz_pair_keeps_colours_columns_and_millimetres(tmp_path, pair):
    laspy = pytest.importorskip("laspy")
    T_utm = make_transform(np.eye(3), UTM_M)
    offset = np.array(UTM_M)
    for name, points_m in (("a", pair.source_m), ("b", pair.target_m)):
        cloud = coloured(transform_points(T_utm, points_m))
        write_cloud(tmp_path / f"{name}.laz", Cloud(**{**vars(cloud), "offset_m": offset}))
    result = files.register_pair_files(
        tmp_path / "a.laz", tmp_path / "b.laz", tmp_path / "out", files.Choices()
    )
    assert result.status == "registered"
    source, aligned = read_cloud(tmp_path / "a.laz"), read_cloud(tmp_path / "out" / "aligned.laz")
    expected_m = transform_points(result.T_target_source, source.points_m)
    np.testing.assert_allclose(aligned.points_m, expected_m, atol=1e-4, rtol=0)
    np.testing.assert_array_equal(aligned.colour, source.colour)
    np.testing.assert_array_equal(aligned.columns["label"], source.columns["label"])
    with laspy.open(tmp_path / "out" / "aligned.laz") as file:
        assert file.header.point_count == len(source) and file.header.offsets.tolist() == UTM_M
    page = page_of(tmp_path / "out")
    assert "The motion found" in page and "own colours" in page and len(page) < 10e6
    read = json.loads((tmp_path / "out" / "result.json").read_text())["read"]
    assert read["source"] == ["with colour, label"]


def told_and_placed(kind, folder, scans_m, poses):
    """A file or two of scans on a map, each with the place where its sensor stood."""
    pytest.importorskip({"laz": "laspy", "e57": "pye57"}.get(kind, "numpy"))
    if kind == "ptx":
        for name, points_m, T in zip("ab", scans_m, poses, strict=True):
            rows = [*T[:3, :3].T.tolist(), *T.T.tolist()]
            head = [[len(points_m)], [1], T[:3, 3].tolist(), *rows]
            lines = [" ".join(map(repr, row)) for row in head]
            lines += [" ".join(f"{c:.4f}" for c in point) + " 0.5" for point in points_m]
            (folder / f"{name}.ptx").write_text("\n".join(lines) + "\n")
        return [folder / "a.ptx", folder / "b.ptx"]
    clouds = [
        Cloud(points_m, viewpoint_m=np.zeros(3), offset_m=np.array(UTM_M) * (kind == "laz")).moved(
            T
        )
        for points_m, T in zip(scans_m, poses, strict=True)
    ]
    if kind == "e57":
        write_scans(folder / "site.e57", clouds)
        return read_scans(folder / "site.e57")
    for name, cloud in zip("ab", clouds, strict=True):
        write_cloud(folder / f"{name}.laz", cloud)
    return [folder / "a.laz", folder / "b.laz"]


@pytest.mark.parametrize("kind", ["laz", "e57", "ptx"])
def test_scans_on_a_map_get_the_pose_and_the_verdict_of_their_own_coordinates(tmp_path, pair, kind):
    scans_m = [np.round(points_m[::2], 4) for points_m in (pair.source_m, pair.target_m)]
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) if kind != "laz" else np.eye(3)
    poses = [make_transform(turn, np.array(UTM_M)), make_transform(turn.T, np.array(UTM_M))]
    own = register(*[Cloud(points_m, viewpoint_m=np.zeros(3)) for points_m in scans_m])
    told = register(*told_and_placed(kind, tmp_path, scans_m, poses))
    assert (told.status, round(told.confidence, 3)) == (own.status, round(own.confidence, 3))
    T_own = np.linalg.inv(poses[1]) @ told.T_target_source @ poses[0]
    expected_m = transform_points(own.T_target_source, scans_m[0])
    np.testing.assert_allclose(transform_points(T_own, scans_m[0]), expected_m, atol=1e-4)


def test_an_e57_of_two_scans_is_registered_and_merged_with_its_poses(tmp_path, pair):
    pytest.importorskip("pye57")
    T_site = make_transform(np.eye(3), [40.0, 20.0, 3.0])
    scans = [
        Cloud(**{**vars(coloured(points_m)), "viewpoint_m": np.zeros(3)}).moved(T_site)
        for points_m in (pair.source_m, pair.target_m)
    ]
    write_scans(tmp_path / "site.e57", scans)
    choices = files.Choices()
    result = register_scan_files([tmp_path / "site.e57"], tmp_path / "out", choices)
    assert result.outcome == "registered" and result.groups == [[0, 1]]
    merged = read_scans(tmp_path / "out" / "merged.e57")
    assert [len(scan) for scan in merged] == [len(scan) for scan in scans]
    for scan, before, T in zip(merged, scans, result.T_group_scan, strict=True):
        np.testing.assert_allclose(
            scan.points_m, transform_points(T, before.points_m), atol=1e-4, rtol=0
        )
        np.testing.assert_array_equal(scan.colour, before.colour)
        np.testing.assert_allclose(scan.viewpoint_m, before.moved(T).viewpoint_m, atol=1e-6)
    assert "In 3-D" in page_of(tmp_path / "out")


def test_a_source_in_another_unit_than_the_target(tmp_path, pair):
    write_cloud(tmp_path / "a.xyz", 1000 * np.asarray(pair.source_m[::3]))
    write_cloud(tmp_path / "b.xyz", pair.target_m[::3])
    refused, told = [
        files.register_pair_files(tmp_path / "a.xyz", tmp_path / "b.xyz", tmp_path / "out", choices)
        for choices in (files.Choices(), files.Choices(source_unit="mm"))
    ]
    assert refused.status == "failed" and "source_unit" in refused.reason
    assert told.status == "registered"


def test_coordinates_that_are_hardly_metres_are_noticed(tmp_path):
    points = np.random.default_rng(0).uniform(0, 8000, (100, 3))
    write_cloud(tmp_path / "a.ply", points)
    assert "say unit=mm" in read_given(tmp_path / "a.ply").cloud.notes[0]
    assert read_given(tmp_path / "a.ply", unit="mm").cloud.notes == ()


def test_scans_are_found_by_file_pattern_and_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scans").mkdir()
    for name in ("a.ply", "b.las", "[1].ply", "notes.md", "._a.ply"):
        (tmp_path / "scans" / name).touch()
    names = ["[1].ply", "a.ply", "b.las"]
    assert [path.name for path in find_scans(["scans"])] == names
    assert [path.name for path in find_scans(["scans/*.las", "scans/[1].ply"])] == names[::-2]
    assert [path.name for path in find_scans([str(tmp_path / "scans" / "*.ply")])] == names[:2]
    assert find_scans(["scans/*.ply", "scans/*.ply"]) == find_scans(["scans/*.ply"])  # each once
    with pytest.raises(FileNotFoundError, match="scans/c"):
        find_scans(["scans/c*"])
