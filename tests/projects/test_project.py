"""Many scans: simulated rooms and floors, scans of elsewhere or that come later, ended runs."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import skipnet
from skipnet.geometry import invert, make_transform, pose_error, random_rotation, transform_points
from skipnet.projects import retrieval, searches
from skipnet.projects.assembly import Word
from skipnet.projects.blocks import Workers
from skipnet.registration.options import Generator
from skipnet.results.project import poses_json, scans_page
from skipnet.simulation.scanning.floors import simulate_floor
from skipnet.simulation.scanning.pairs import simulate_pair, simulate_scans
from skipnet.viz.lengths import Lengths

FLOOR_SEED = 300_000

PLANES = skipnet.RegistrationConfig(generators=[Generator.planes])


@pytest.fixture(scope="module")
def scans():
    return simulate_scans("paper_room", 1, 4, rotation="any", points=25_000)[0]


@pytest.fixture(scope="module")
def result(scans):
    return skipnet.register_many([scan.points_m for scan in scans])


@pytest.fixture(scope="module")
def floor():
    return simulate_floor("floor", FLOOR_SEED, 6).scans


@pytest.fixture(scope="module")
def floor_result(floor):
    return skipnet.register_many([scan.points_m for scan in floor])


def assert_right(scans, group, T_group_scan, most_deg, most_m):
    first = group[0]
    for scan in group:
        T_true = invert(scans[first].T_world_sensor) @ scans[scan].T_world_sensor
        rotation_rad, translation_m = pose_error(T_group_scan[scan], T_true)
        assert np.rad2deg(rotation_rad) < most_deg and translation_m < most_m


def test_every_scan_of_a_room_finds_its_place_and_every_pair_is_told(scans, result):
    assert result.groups == [[0, 1, 2, 3]] and result.status == ["registered"] * 4
    assert result.outcome == "registered" and "all 4 scans" in result.reason
    assert set(result.pairs) == set(combinations(range(4), 2)) == set(result.words)
    np.testing.assert_array_equal(result.T_group_scan[0], np.eye(4))
    assert_right(scans, result.groups[0], result.T_group_scan, 0.05, 0.003)
    assert set(result.links) == set(result.pairs)
    assert max(link.closure_m for link in result.links.values()) < 0.005
    assert list(result.timings_s) == ["skip-map", "pairs", "groups", "pose graph"]
    assert result.position_std_m[0] == 0 and 0 < max(result.position_std_m) < 0.01


def test_on_a_floor_of_alike_rooms_what_comes_together_is_right_and_the_rest_in_doubt(
    floor, floor_result
):
    result = floor_result
    assert len(result.groups[0]) >= 2
    for group in result.groups:
        assert_right(floor, group, result.T_group_scan, 0.1, 0.02)
    # Rooms alike register with each other by themselves; the others refute it.
    assert Word.REFUTED in result.words.values() or Word.OPEN in result.words.values()
    for scan, status in enumerate(result.status):
        assert (status == "ambiguous") == ([scan] in result.groups)


def test_a_scan_that_is_there_twice_stands_in_one_place_and_holds_nobody_up(floor, floor_result):
    placed = floor_result.groups[0]
    again = skipnet.register_many([scan.points_m for scan in [*floor, floor[placed[1]]]])
    group = next(group for group in again.groups if len(floor) in group)
    assert set(placed) < set(group)
    assert_right([*floor, floor[placed[1]]], group, again.T_group_scan, 0.1, 0.02)


def test_the_order_of_the_scans_and_their_frames_do_not_matter(scans, result):
    order = [2, 0, 3, 1]
    rng = np.random.default_rng(0)
    frames = [make_transform(random_rotation(rng), rng.normal(size=3) * 9) for _ in order]
    moved = [transform_points(T, scans[k].points_m) for k, T in zip(order, frames, strict=True)]
    again = skipnet.register_many(moved, viewpoints=[T[:3, 3] for T in frames])
    assert again.groups == result.groups
    for row, (k, T) in enumerate(zip(order, frames, strict=True)):
        expected = frames[0] @ invert(result.T_group_scan[order[0]]) @ result.T_group_scan[k]
        rotation_rad, translation_m = pose_error(again.T_group_scan[row], expected @ invert(T))
        assert np.rad2deg(rotation_rad) < 0.05 and translation_m < 0.005


def test_a_scan_of_elsewhere_stays_apart_and_is_named(scans):
    lone_wall_m = np.random.default_rng(0).uniform([2, -2, -1], [2, 2, 1], size=(20_000, 3))
    result = skipnet.register_many([scans[0].points_m, lone_wall_m, scans[1].points_m])
    assert result.groups == [[0, 2], [1]]
    assert result.status == ["registered", "ambiguous", "registered"]
    assert result.outcome == "ambiguous" and "in doubt: scan 1" in result.reason
    assert_right(scans[:1] * 2 + scans[1:2], [0, 2], result.T_group_scan, 0.5, 0.03)


def test_two_rooms_stay_two_groups():
    elsewhere = simulate_scans("oblique", 7, 3, rotation="any", points=25_000)[0]
    here = simulate_scans("paper_room", 1, 3, rotation="any", points=25_000)[0]
    mixed = [here[0], elsewhere[0], elsewhere[1], here[1], here[2], elsewhere[2]]
    result = skipnet.register_many([scan.points_m for scan in mixed])
    assert result.groups == [[0, 3, 4], [1, 2, 5]]
    for group in result.groups:
        assert_right(mixed, group, result.T_group_scan, 0.1, 0.01)


def test_scans_that_come_later_give_what_they_give_at_once(scans, tmp_path, monkeypatch):
    size_m = 0.2
    at_once = skipnet.register_many([s.points_m for s in scans], voxel_size_m=size_m)
    project = skipnet.Project(tmp_path, voxel_size_m=size_m)
    for scan in scans[:3]:
        project.add(scan.points_m)
    assert project.solve().groups == [[0, 1, 2]]
    asked = counted(monkeypatch)
    assert project.add(scans[3].points_m) == 3
    later = project.solve()
    assert len(asked) == 3  # the pairs of the new scan
    for T, expected in zip(later.T_group_scan, at_once.T_group_scan, strict=True):
        np.testing.assert_array_equal(T, expected)


def test_a_run_that_was_ended_goes_on_and_gives_the_same(scans, tmp_path, monkeypatch):
    clouds_m = [scan.points_m for scan in scans]
    whole = skipnet.register_many(clouds_m)

    def ended(stage, done, of):
        if done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        skipnet.register_many(clouds_m, folder=tmp_path, progress=ended)
    kept = sorted((tmp_path / "pairs").iterdir())
    assert len(kept) == 4
    kept[0].write_text(kept[0].read_text()[:100])  # half a file is no file
    asked = counted(monkeypatch)
    again = skipnet.register_many(clouds_m, folder=tmp_path)
    assert len(asked) == 3
    for T, expected in zip(again.T_group_scan, whole.T_group_scan, strict=True):
        np.testing.assert_array_equal(T, expected)
    assert again.words == whole.words


@pytest.mark.parametrize("workers", [1, 2])
def test_of_many_scans_every_pair_is_glanced_at_and_the_promising_ones_are_searched(
    scans, tmp_path, monkeypatch, workers
):
    rest_m = np.random.default_rng(0).uniform(-9, 9, size=(500, 3))  # shares nothing
    clouds_m = [scans[0].points_m, rest_m, rest_m + 50, scans[1].points_m]
    for name, value in (("PARTNERS", 1), ("NEIGHBOURS", (1,))):
        monkeypatch.setattr(retrieval, name, value)
    monkeypatch.setattr(searches, "ALL_PAIRS", 3)
    asked, options = counted(monkeypatch), {"config": PLANES, "voxel_size_m": 0.1}
    found = skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(workers), **options)
    assert len(list((tmp_path / "promises").iterdir())) == 6
    assert [0, 3] in found.groups and set(found.pairs) >= {(0, 3), (0, 1), (1, 2), (2, 3)}
    assert len(found.pairs) < 6
    if workers == 1:
        assert len(asked) == len(found.pairs)
    for file in (tmp_path / "promises").iterdir():
        file.write_text("what is no number")
    again = skipnet.register_many(clouds_m, folder=tmp_path, **options)
    assert set(again.pairs) == set(found.pairs)


def counted(monkeypatch):
    """The searches that are made from here on."""
    asked = []
    search = searches.search

    def counting(source, target, config, prior):
        asked.append((source, target))
        return search(source, target, config, prior)

    monkeypatch.setattr(searches, "search", counting)
    return asked


def test_results_tell_groups_places_and_every_pair(result):
    doubtful = replace(
        result,
        groups=[[0, 1, 2], [3]],
        status=[*result.status[:3], skipnet.types.Status.AMBIGUOUS],
        places={3: [projects_place(0), projects_place(0)]},
        words=result.words | {(0, 3): Word.REFUTED},
    )
    told = json.loads(poses_json(doubtful, list("abcd"), 0, Lengths()))
    assert told["groups"] == [[0, 1, 2], [3]] and told["status"] == "ambiguous"
    assert told["scans"][3]["status"] == "ambiguous" and len(told["scans"][3]["places"]) == 2
    words = {(pair["target"], pair["source"]): pair["word"] for pair in told["pairs"]}
    assert words == {key: str(word) for key, word in doubtful.words.items()}
    rest = ("", np.zeros(3)), (b"", b""), 0, Lengths("ft"), ["one of four"]
    page = scans_page(doubtful, list("abcd"), *rest)
    assert "closure (in)" in page and "x (ft)" in page and "one of four" in page
    assert "Scan 3 (d) fits in 2 places" in page and "refuted" in page
    assert "Nothing." in scans_page(result, list("abcd"), *rest)


def projects_place(group):
    from skipnet.projects.assembly import Place

    return Place(group, np.eye(4))


def test_bad_input_names_the_scan():
    cloud_m = simulate_pair("paper_room", 1, points=500).pair.source_m
    with pytest.raises(ValueError, match="got 1 scans: expected two or more"):
        skipnet.register_many([cloud_m])
    with pytest.raises(ValueError, match=r"scans\[1\]: got 2 points"):
        skipnet.register_many([cloud_m, cloud_m[:2]])
    with pytest.raises(ValueError, match="got 1 viewpoints for 2 scans"):
        skipnet.register_many([cloud_m, cloud_m], viewpoints=[None])
    with pytest.raises(ValueError, match=r"viewpoints\[1\]=.* expected"):
        skipnet.register_many([cloud_m, cloud_m], viewpoints=[None, [0.0, 1.0]])
    with pytest.raises(ValueError, match="voxel"):
        skipnet.Project(voxel_size_m=-1.0)
