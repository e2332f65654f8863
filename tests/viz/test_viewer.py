"""The viewer's data, taken apart as the browser does; and in a browser, where there is one."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from skipnet.geometry import make_transform, transform_points
from skipnet.viz import html
from skipnet.viz.lengths import Lengths
from skipnet.viz.viewer import MOST_POINTS, ViewedPose, ViewedScan, viewer

UTM_M = np.array([500_000.0, 5_400_000.0, 100.0])
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
WICKED = "</script><img src=x onerror=alert(1)>.ply"


@pytest.fixture
def scans():
    rng = np.random.default_rng(0)
    points_m = rng.uniform(-3, 3, (500, 3))
    source = ViewedScan(WICKED, points_m, "#D55E00", residuals_m=np.linspace(0, 0.1, 500))
    target = ViewedScan("target", points_m[:400] + UTM_M, "#0072B2", np.full((400, 3), 7))
    return [source, target]


@pytest.fixture
def poses():
    T = make_transform(TURN, UTM_M)
    return [
        ViewedPose("before", "as they came", (np.eye(4), np.eye(4))),
        ViewedPose("after", "moved", (T, np.eye(4))),
    ]


def content(view):
    [text] = re.findall(r'<script type="application/json" class="scans">(.*?)</script>', view)
    return json.loads(text)


def places_m(data, pose, number):
    """Where the browser puts the points of a scan."""
    scan = data["scans"][number]
    steps = np.frombuffer(base64.b64decode(scan["places"]), "<u2").reshape(-1, 3)
    local_m = np.array(scan["low"]) + steps / 65535 * np.array(scan["span"])
    model = np.array(data["poses"][pose]["matrices"][number]).reshape(4, 4).T
    return transform_points(model, local_m) + data["centre"]


def test_a_scan_without_a_place_is_not_in_the_pose_and_lengths_are_the_readers(scans, poses):
    lone = ViewedPose("alone", "one of two", (np.eye(4), None))
    view = viewer(scans, [lone, *poses], brightest_m=0.0254, lengths=Lengths("ft"))
    data = content(view)
    assert data["poses"][0]["matrices"][1] is None and len(data["poses"][1]["matrices"][1]) == 16
    assert data["unit"] == {"name": "ft", "metres": 0.3048} and "yellow 1 in and more" in view
    assert abs(data["centre"][0]) < 10  # of what the first pose shows


def test_the_browser_puts_every_point_where_its_pose_does(scans, poses):
    data = content(viewer(scans, poses, start=1))
    for pose in range(2):
        for number, scan in enumerate(scans):
            expected_m = transform_points(poses[pose].T_common_scan[number], scan.points_m)
            found_m = places_m(data, pose, number)
            by_place = [np.lexsort(points_m.round(2).T) for points_m in (expected_m, found_m)]
            away_m = np.abs(expected_m[by_place[0]] - found_m[by_place[1]])
            assert np.median(away_m) < 1e-4  # rounding swaps some rows, not many
    assert np.abs(data["poses"][1]["matrices"]).max() < 10  # single precision keeps micrometres


def test_colours_and_residuals_belong_to_their_points(scans, poses):
    data = content(viewer(scans, poses, start=1, brightest_m=0.1))
    residuals = np.frombuffer(base64.b64decode(data["scans"][0]["residuals"]), np.uint8)
    found_m = places_m(data, 1, 0)
    expected_m = transform_points(poses[1].T_common_scan[0], scans[0].points_m)
    nearest = np.argmin(np.linalg.norm(found_m[:, None] - expected_m, axis=2), axis=1)
    np.testing.assert_allclose(residuals / 2550, scans[0].residuals_m[nearest], atol=3e-4)
    assert set(base64.b64decode(data["scans"][1]["own"])) == {7}


def test_names_cannot_leave_their_place(scans, poses):
    view = viewer(scans, poses)
    assert WICKED not in view and "<img" not in view.split("<script>")[0]
    assert content(view)["scans"][0]["name"] == WICKED


def test_many_points_are_thinned_and_the_page_stays_small(poses):
    points_m = np.random.default_rng(0).uniform(-30, 30, (700_000, 3))
    scans = [ViewedScan(name, points_m, "#000000") for name in "ab"]
    view = viewer(scans, poses)
    counts = [len(places_m(content(view), 0, number)) for number in range(2)]
    assert sum(counts) <= MOST_POINTS and len(view) < 5e6


def test_a_browser_draws_it_without_an_error(tmp_path, scans, poses):
    browser = shutil.which("chromium") or pytest.skip("no browser: apt-get install chromium")
    check = """<pre id="log"></pre><script>
        const canvas = document.querySelector("canvas"), log = document.querySelector("#log");
        const box = canvas.getBoundingClientRect();
        for (const kind of ["pointerdown", "pointerup"]) canvas.dispatchEvent(new PointerEvent(kind,
          { pointerId: 1, clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }));
        document.querySelector("[name=pose]").click();
        log.textContent = "said: " + document.querySelector(".said").textContent;
        </script>"""
    page = tmp_path / "page.html"
    page.write_text(html.page("test", *[viewer(scans, poses, start=1)] * 2, check))
    command = [browser, "--headless=new", "--no-sandbox", "--use-gl=angle", "--dump-dom"]
    command += [
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--virtual-time-budget=2000",
    ]
    command += ["--enable-logging=stderr", f"--user-data-dir={tmp_path}/profile", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert "said: as they came" in run.stdout
    assert "CONSOLE" not in run.stderr
