"""register.py as a user runs it: results, exit codes, and one clear line for every bad input."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.reading import read_points
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import invert, pose_error, transform_points
from skipnet.simulation.scanning.pairs import simulate_pair, simulate_scans

ROOT = Path(__file__).parents[2]
PAIR_FILES = {"result.json", "aligned.ply", "before_after.png", "report.html"}


def register_py(folder, *arguments, flags=()):
    command = [sys.executable, *flags, str(ROOT / "register.py"), *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", seed=1, points=40_000).pair


@pytest.fixture
def stand(tmp_path, pair):
    """Where the user stands: two scans in a folder below."""
    write_cloud(tmp_path / "scans" / "a.ply", pair.source_m)
    np.save(tmp_path / "scans" / "b.npy", pair.target_m)
    return tmp_path


def test_two_files_come_out_registered_with_every_result(stand, pair):
    run = register_py(
        stand, "source=scans/a.ply", "target=scans/b.npy", "output_dir=out/first", "seed=3"
    )
    assert (run.returncode, run.stderr) == (0, "")
    assert "registered" in run.stdout and "out/first/report.html" in run.stdout
    assert {path.name for path in (stand / "out" / "first").iterdir()} == PAIR_FILES | {".skipnet"}
    assert {path.name for path in stand.iterdir()} == {"scans", "out"}

    result = json.loads((stand / "out" / "first" / "result.json").read_text())
    T_target_source = np.array(result["T_target_source"])
    rotation_rad, translation_m = pose_error(T_target_source, pair.T_target_source)
    assert np.rad2deg(rotation_rad) < 0.5 and translation_m < 0.03
    assert result["status"] == "registered" and 0 <= result["confidence"] <= 1 and result["reason"]
    assert np.array(result["T_target_source_coarse"]).shape == (4, 4)
    assert result["timings_s"] and all(time_s >= 0 for time_s in result["timings_s"].values())
    assert result["inputs"] == {"source": "scans/a.ply", "target": "scans/b.npy"}
    assert result["seed"] == 3
    assert set(result["versions"]) == {
        *("skipnet", "python", "numpy", "numba", "scipy", "small_gicp", "torch", "open3d")
    }

    aligned_m = read_points(stand / "out" / "first" / "aligned.ply")
    np.testing.assert_allclose(
        aligned_m, transform_points(T_target_source, pair.source_m), atol=1e-9
    )
    assert (stand / "out" / "first" / "before_after.png").read_bytes().startswith(b"\x89PNG")
    page = (stand / "out" / "first" / "report.html").read_text()
    assert "://" not in page and ">registered<" in page and 'src="data:image/png;base64,' in page


def test_many_scans_come_out_in_the_frame_of_the_first(tmp_path):
    scans, _ = simulate_scans("paper_room", 1, 3, points=40_000)
    for name, scan in zip("abc", scans, strict=True):
        write_cloud(tmp_path / f"{name}.ply", scan.points_m)
    (tmp_path / "gnss.csv").write_text("scan,x_m,y_m,z_m\na.ply,0,0,0\nb.ply,500,0,0\n")
    given = "scans=[a.ply,b.ply,c.ply]", "priors=gnss.csv", "workers=2", "output_dir=out"
    run = register_py(tmp_path, *given)
    assert (run.returncode, run.stderr) == (0, "")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    kept = {".skipnet", "pairs", "scans", "voxel_size.json"}
    assert written == kept | {"poses.json", "merged.ply", "scans.png", "report.html"}

    poses = json.loads((tmp_path / "out" / "poses.json").read_text())
    assert [scan["path"] for scan in poses["scans"]] == ["a.ply", "b.ply", "c.ply"]
    assert poses["status"] == "registered" and poses["groups"] == [[0, 1, 2]]
    for written_scan, scan in zip(poses["scans"], scans, strict=True):
        T_true = invert(scans[0].T_world_sensor) @ scan.T_world_sensor
        rotation_rad, translation_m = pose_error(np.array(written_scan["T_group_scan"]), T_true)
        assert np.rad2deg(rotation_rad) < 0.5 and translation_m < 0.03
    merged_m = read_points(tmp_path / "out" / "merged.ply")
    assert len(merged_m) == sum(len(scan.points_m) for scan in scans)


def test_many_scans_of_a_map_keep_its_coordinates(tmp_path):
    """LAS counts from an offset, where the sensor may have stood: another word than "auto"."""
    pytest.importorskip("laspy")
    map_m = np.array([500_000.0, 5_400_000, 100])
    scans, _ = simulate_scans("paper_room", 1, 2, points=40_000)
    for name, scan in zip("ab", scans, strict=True):
        write_cloud(tmp_path / f"{name}.laz", Cloud(scan.points_m + map_m, offset_m=map_m))
    for _ in range(2):  # the second goes on from what the first kept
        run = register_py(tmp_path, "scans=[a.laz,b.laz]", "output_dir=out")
        assert (run.returncode, run.stderr) == (0, "")
    T_true = invert(scans[0].T_world_sensor) @ scans[1].T_world_sensor
    expected_m = transform_points(T_true, scans[1].points_m) + map_m
    merged_m = read_points(tmp_path / "out" / "merged.laz")
    away_m = merged_m[len(scans[0].points_m) :] - expected_m
    assert np.linalg.norm(away_m, axis=1).max() < 0.03


def test_what_a_format_has_no_room_for_is_said_once(tmp_path, pair):
    for name, points_m in (("a", pair.source_m), ("b", pair.target_m)):
        write_cloud(tmp_path / f"{name}.ply", Cloud(points_m, viewpoint_m=np.zeros(3)))
    run = register_py(tmp_path, "source=a.ply", "target=b.ply", "format=xyz", "output_dir=out")
    assert (run.returncode, run.stderr) == (0, "aligned.xyz: written without the sensor's place\n")


def test_scans_of_nothing_in_common_exit_with_3_and_still_write_everything(tmp_path):
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        np.save(tmp_path / f"{name}.npy", rng.normal(size=(3000, 3)))
    run = register_py(tmp_path, "source=a.npy", "target=b.npy", "output_dir=out")
    assert (run.returncode, run.stderr) == (3, "")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["status"] in (
        "ambiguous",
        "failed",
    )
    assert {path.name for path in (tmp_path / "out").iterdir()} == PAIR_FILES | {".skipnet"}


def test_without_arguments_it_simulates_a_pair_and_says_where_to_look(tmp_path):
    run = register_py(tmp_path)
    assert run.returncode == 0, run.stderr
    assert "Off the truth by" in run.stdout and "runs/register/report.html" in run.stdout
    written = {path.name for path in (tmp_path / "runs" / "register").iterdir()}
    assert written == PAIR_FILES | {".skipnet", "simulated_source.ply", "simulated_target.ply"}


BAD = {
    "missing": (["source=scans/a.ply", "target=scans/c.ply"], "scans/c.ply: no such file"),
    "empty": (["source=scans/a.ply", "target=empty.ply"], "empty.ply: the file is empty"),
    "truncated": (["source=cut.ply", "target=scans/b.npy"], "cut.ply: truncated"),
    "not points": (
        ["source=picture.ply", "target=scans/b.npy"],
        "picture.ply: truncated or no depth image",
    ),
    "two points": (["source=two.npy", "target=scans/b.npy"], "two.npy: got 2 points"),
    "a line": (["source=line.npy", "target=scans/b.npy"], "on one line"),
    "NaN alone": (["source=scans/a.ply", "target=nan.npy"], "nan.npy: holds no points but NaN"),
    "unknown extension": (["source=scans/a.ply", "target=b.doc"], "expected one of .ply, .pcd"),
    "half a pair": (["source=scans/a.ply"], "give source=FILE and target=FILE together"),
    "misspelt": (["source=scans/a.ply", "traget=scans/b.npy"], "did you mean target?"),
    "misspelt with plus": (["+voxel_size=0.1"], "did you mean voxel_size_m?"),
    "out of range": (["voxel_size_m=0"], "voxel_size_m=0.0: expected metres above 0"),
    "bad viewpoint": (["source_viewpoint=[1,2]"], "source_viewpoint=[1, 2]: expected auto"),
    "no voxel": (["voxel_size_m=inf"], "voxel_size_m=inf: expected metres above 0"),
    "no samples": (
        ["registration.final_samples=-5"],
        "final_samples=-5: expected a whole number of 50",
    ),
    "no weight": (["registration.violation_weight=inf"], "violation_weight=inf: expected a number"),
    "viewpoint of scans": (
        ["scans=[scans/a.ply,scans/b.npy]", "source_viewpoint=null"],
        "are for two scans",
    ),
    "workers of two": (["workers=2"], "priors, workers and executor are for many scans"),
    "no workers": (["scans=[scans]", "workers=0"], "workers=0: expected 1 or more, or -1"),
    "no executor": (["scans=[scans]", "executor=dusk"], "executor=dusk: expected local, ray"),
    "missing priors": (["scans=[scans]", "priors=none.yaml"], "none.yaml: no such file"),
    "one scan": (["scans=[scans/a.ply]"], "holds one scan: expected two or more"),
    "both ways": (["source=a.ply", "target=b.ply", "scans=[a.ply,b.ply]"], "exclude each other"),
    "no flag": (["--fast"], "unrecognized arguments: --fast; options are written option=value"),
    "no option": (["=3"], "'=3' is not an override"),
    "how far no prior is off": (["prior_position_std_m=1"], "give it with prior=FILE"),
    "no network": (
        ["source=scans/a.ply", "target=scans/b.npy", "registration.network=scans/a.ply"],
        "no file of the network",
    ),
    "a missing scan": (["scans=[scans/a.ply,scans/c.ply]"], "scans/c.ply: no such file"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_exit_code_2(stand, case):
    whole = (stand / "scans" / "a.ply").read_bytes()
    (stand / "empty.ply").write_bytes(b"")
    (stand / "cut.ply").write_bytes(whole[: len(whole) // 2])
    (stand / "picture.ply").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(500))
    (stand / "b.doc").write_text("v 1 2 3\n")
    points = np.random.default_rng(0).normal(size=(100, 3))
    np.save(stand / "two.npy", points[:2])
    np.save(stand / "line.npy", points[:, :1] * [[1.0, 2.0, 3.0]])
    np.save(stand / "nan.npy", points * np.nan)
    before = {path: path.read_bytes() for path in stand.rglob("*") if path.is_file()}

    arguments, words = BAD[case]
    run = register_py(stand, *arguments, "output_dir=out")

    assert run.returncode == 2
    assert run.stderr.count("\n") == 1 and run.stderr.startswith("register: ")
    assert words in run.stderr
    assert {path: path.read_bytes() for path in stand.rglob("*") if path.is_file()} == before
    assert not (stand / "out").exists()


def test_an_input_is_never_overwritten(stand):
    write_cloud(stand / "out" / "aligned.ply", read_points(stand / "scans" / "a.ply"))
    before = (stand / "out" / "aligned.ply").read_bytes()
    run = register_py(stand, "source=out/aligned.ply", "target=scans/b.npy", "output_dir=out")
    assert run.returncode == 2 and "would be overwritten" in run.stderr
    assert (stand / "out" / "aligned.ply").read_bytes() == before


@pytest.mark.parametrize(
    "arguments", [["--help"], ["sorce=a.ply"], ["source=nowhere.ply", "target=b.ply"]]
)
def test_help_and_errors_load_neither_torch_nor_open3d(tmp_path, arguments):
    run = register_py(tmp_path, *arguments, flags=["-X", "importtime"])
    loaded = {line.rsplit("|", 1)[-1].strip() for line in run.stderr.splitlines() if "|" in line}
    assert "hydra" in loaded
    assert not loaded & {"torch", "open3d", "matplotlib", "sklearn"}


def test_help_names_every_option(tmp_path):
    from dataclasses import fields

    from skipnet.commands.register import RegisterConfig

    page = register_py(tmp_path, "--help").stdout
    assert [field.name for field in fields(RegisterConfig) if f"{field.name}:" not in page] == []
