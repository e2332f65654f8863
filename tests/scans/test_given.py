"""What may be given as a scan, and that a file's viewpoint is believed."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.writing import write_scans
from skipnet.geometry import invert, make_transform
from skipnet.scans.given import taken
from skipnet.scans.scan import AutoAt
from skipnet.simulation.scanning.pairs import simulate_pair


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-1, 1, (60, 3))


def points_and_viewpoint(scan, viewpoint="auto"):
    return taken(scan, viewpoint, "source", "source_viewpoint")


def test_arrays_tensors_clouds_and_files_are_taken(tmp_path, points):
    import open3d as o3d
    import torch

    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.scales = [1e-6] * 3
    las.x, las.y, las.z = points.T
    skipnet.write_cloud(tmp_path / "a.ply", points)
    wider = np.column_stack([points, np.ones((60, 2))])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    tensors = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
    for scan in (points, points.tolist(), wider, torch.tensor(points), cloud, tensors, las,
                 Cloud(points), tmp_path / "a.ply", str(tmp_path / "a.ply")):  # fmt: skip
        places, viewpoint = points_and_viewpoint(scan)
        np.testing.assert_allclose(places, points, atol=1e-6)
        assert isinstance(viewpoint, str) and viewpoint == "auto"


def test_the_offset_of_a_laspy_cloud_is_tried_as_the_sensor_s_place(points):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.offsets = [5e5, 5.4e6, 100]
    las.x, las.y, las.z = (points + las.header.offsets).T
    assert points_and_viewpoint(las)[1] == AutoAt((5e5, 5.4e6, 100.0))


def test_points_by_column_are_refused(points):
    with pytest.raises(ValueError, match=r"source: got float64 of shape \(3, 60\)"):
        points_and_viewpoint(points.T)


def test_a_cloud_s_viewpoint_is_taken_unless_the_caller_knows_better(points):
    cloud = Cloud(points, viewpoint_m=np.array([1.0, 2, 3]))
    assert points_and_viewpoint(cloud)[1].tolist() == [1, 2, 3]
    assert points_and_viewpoint(cloud, None)[1] is None
    assert points_and_viewpoint(cloud, [0, 0, 0])[1] == [0, 0, 0]


def test_a_doorway_in_an_e57_registers_as_in_local_coordinates(tmp_path):
    """Posed scans stand far from the origin: without the poses' places nothing tells the sides."""
    pytest.importorskip("pye57")
    pair = simulate_pair("doorway", 1).pair
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    T_site = make_transform(turn, [3000.0, -2000.0, 50.0])
    scans = []
    for points_m in (pair.source_m, pair.target_m):
        scans.append(Cloud(points_m, viewpoint_m=np.zeros(3)).moved(T_site))
        write_scans(tmp_path / f"{len(scans)}.e57", scans[-1:])
    local = skipnet.register(pair.source_m, pair.target_m)
    posed = skipnet.register(tmp_path / "1.e57", tmp_path / "2.e57")
    blind = skipnet.register(*scans, source_viewpoint=None, target_viewpoint=None)
    assert blind.status == "ambiguous"
    assert (posed.status, local.status) == ("registered", "registered")
    T_back = invert(T_site) @ posed.T_target_source @ T_site
    np.testing.assert_allclose(T_back[:3, 3], local.T_target_source[:3, 3], atol=1e-4)
    np.testing.assert_allclose(T_back[:3, :3], local.T_target_source[:3, :3], atol=1e-6)


def test_a_result_moves_points_and_clouds_and_prints_as_a_sentence(points):
    result = skipnet.register(points, points + [1.0, 2, 3])
    assert str(result).startswith(f"{result.status} (confidence ") and result.reason in str(result)
    moved = result.transform(Cloud(points, normals=points))
    np.testing.assert_array_equal(moved.points_m, result.transform(points))
    T = result.T_target_source
    np.testing.assert_allclose(moved.points_m, points @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(moved.normals, points @ T[:3, :3].T)


def test_rows_of_different_lengths_are_named():
    with pytest.raises(ValueError, match="^source: expected numbers"):
        taken([[1, 2, 3], [4, 5]], "auto", "source", "source_viewpoint")
