"""Thinning while reading: against one Skip-map of all the points."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats import e57
from skipnet.clouds.formats.reading import read_chunks, read_points, read_scans
from skipnet.clouds.formats.writing import write_cloud, write_scans
from skipnet.geometry import pose_error, transform_points
from skipnet.registration.options import RegistrationConfig
from skipnet.results import files, inputs
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.streaming import thin_chunks
from skipnet.skipmap.tree import build_tree

FINEST_M = 2.0**-6


@pytest.fixture(scope="module")
def points_m():
    rng = np.random.default_rng(0)
    return rng.uniform(size=(30_000, 3)) * [20.0, 10.0, 0.1] + [4e5, 5e6, 100.0]


@pytest.mark.parametrize("chunks", [1, 7])
@pytest.mark.parametrize("most", [100, 3000, 100_000])
def test_centroids_are_those_of_the_finest_voxels_few_enough(points_m, chunks, most):
    pieces = np.array_split(points_m, chunks)
    first_m = pieces[0]
    origin_m = np.round(0.5 * (first_m.min(axis=0) + first_m.max(axis=0)))
    level = 0
    while len(expected := build_tree(points_m, FINEST_M * 2**level, origin_m)) > most:
        level += 1
    thinned = thin_chunks(pieces, "scan", most, FINEST_M)
    np.testing.assert_array_equal(thinned.keys, expected.keys)
    np.testing.assert_allclose(thinned.centroids_m, expected.centroids_m, atol=1e-7)
    np.testing.assert_array_equal(thinned.moments.count, expected.moments.count)


def test_any_kind_of_numbers_is_thinned(points_m):
    expected = thin_chunks([points_m.astype(np.float32)], "scan")
    for kind, order in ((">f4", "C"), ("<f4", "F"), (">f4", "F")):
        given = thin_chunks([points_m.astype(np.float32).astype(kind, order=order)], "scan")
        np.testing.assert_array_equal(given.keys, expected.keys)
        np.testing.assert_allclose(given.moments.sums, expected.moments.sums)


def test_scans_too_wide_for_the_finest_voxels_get_coarser_ones(points_m):
    far_m = np.array([[9e6, 5e6, 0.0], [-9e6, 4e6, 0.0]])
    thinned = thin_chunks([points_m, far_m], "scan", 1000, FINEST_M)
    assert 1 < len(thinned) <= 1000
    assert np.abs(thinned.centroids_m - far_m[0]).sum(axis=1).min() < 1.0


def test_what_cannot_be_thinned_is_refused(points_m):
    with pytest.raises(ValueError, match="a.ply: holds no points"):
        thin_chunks([], "a.ply")
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="a.ply: holds NaN or infinite"):
            thin_chunks([points_m[:5], np.full((2, 3), bad)], "a.ply")


def test_voxels_register_as_well_as_the_points_they_hold():
    pair = simulate_pair("paper_room", 2, points=400_000).pair
    thinned = [
        thin_chunks([points_m], "scan", 30_000) for points_m in (pair.source_m, pair.target_m)
    ]
    assert all(len(tree) < 30_000 < tree.moments.count.sum() for tree in thinned)
    config = RegistrationConfig(denoise=True, denoise_sigma=20.0)
    for result in (skipnet.register(*thinned), skipnet.register(*thinned, config=config)):
        assert result.status == "registered"
        rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
        assert rotation_rad < 2e-4 and translation_m < 0.0005


def test_voxels_without_a_surface_are_refused():
    line_m = np.linspace(0, 1, 50)[:, None] * [1.0, 2.0, 0.0]
    with pytest.raises(ValueError, match="source: all 50 points lie on one line"):
        skipnet.register(thin_chunks([line_m], "line"), np.eye(3))


def test_a_large_file_is_thinned_to_register_and_written_whole(tmp_path, monkeypatch):
    pair = simulate_pair("paper_room", 1, points=40_000).pair
    paths = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for path, points_m in zip(paths, (pair.source_m, pair.target_m), strict=True):
        write_cloud(path, points_m)
    monkeypatch.setattr(inputs, "LARGE_FILE_BYTES", 1000)
    monkeypatch.setattr(inputs, "read_cloud", None)  # reads files as a whole
    monkeypatch.setattr("skipnet.skipmap.streaming.thin_chunks.__defaults__", (20_000, 2.0**-10))
    result = files.register_pair_files(*paths, tmp_path / "out", files.Choices())
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    assert rotation_rad < pair.success_rotation_rad and translation_m < pair.success_translation_m
    aligned_m = read_points(tmp_path / "out" / "aligned.ply")
    expected_m = transform_points(result.T_target_source, pair.source_m)
    np.testing.assert_allclose(aligned_m, expected_m, atol=1e-9)
    assert (
        f"{len(pair.source_m):,} points, read into"
        in (tmp_path / "out" / "report.html").read_text()
    )


def test_of_a_packed_file_counts_what_it_unpacks_to(tmp_path, monkeypatch):
    pytest.importorskip("laspy")
    pair = simulate_pair("paper_room", 1, points=40_000).pair
    packed, plain = tmp_path / "a.laz", tmp_path / "a.las"
    for path in (packed, plain):
        write_cloud(path, pair.source_m)
    sizes = packed.stat().st_size, plain.stat().st_size
    assert sizes[0] < 0.7 * sizes[1]
    monkeypatch.setattr(inputs, "LARGE_FILE_BYTES", sum(sizes) // 2)
    assert inputs.read_given(packed).is_large and inputs.read_given(plain).is_large
    renamed = packed.rename(tmp_path / "packed.las")  # what is in it counts
    assert inputs.read_given(renamed).is_large
    monkeypatch.setattr(inputs, "LARGE_FILE_BYTES", sizes[1])
    assert not inputs.read_given(renamed).is_large


def test_scans_of_an_e57_come_in_pieces_and_as_wholes_alike(tmp_path, monkeypatch):
    pytest.importorskip("pye57")
    pair = simulate_pair("paper_room", 1, points=20_000).pair
    scans = [
        Cloud(points_m, intensity=np.arange(float(len(points_m))), viewpoint_m=place_m)
        for points_m, place_m in ((pair.source_m, [0.0, 1, 2]), (pair.target_m, [3.0, 4, 5]))
    ]
    path = tmp_path / "two.e57"
    write_scans(path, scans)
    whole = read_scans(path)
    monkeypatch.setattr(e57, "RECORDS_AT_ONCE", 3000)
    again = read_scans(path)
    pieces = list(read_chunks(path))
    assert len(whole) == len(again) == 2 and len(pieces) > 10
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one.points_m, other.points_m)
        np.testing.assert_array_equal(one.viewpoint_m, other.viewpoint_m)
    joined_m = np.concatenate([piece.points_m for piece in pieces])
    np.testing.assert_array_equal(joined_m, np.concatenate([one.points_m for one in whole]))
    joined = np.concatenate([piece.intensity for piece in pieces])
    np.testing.assert_array_equal(joined, np.concatenate([one.intensity for one in whole]))
    write_cloud(tmp_path / "again.e57", iter(pieces))
    assert [len(one) for one in read_scans(tmp_path / "again.e57")] == [len(one) for one in whole]
    monkeypatch.setattr(inputs, "LARGE_FILE_BYTES", 1000)
    given = inputs.read_given(path)
    assert given.is_large and given.cloud.viewpoint_m is None  # two scans have no one place
