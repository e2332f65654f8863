"""What a file holds beside its points: written, read by the format's own library, read by us."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats.reading import read_scans
from skipnet.clouds.formats.writing import WRITABLE, write_scans
from skipnet.geometry import make_transform

UTM_M = np.array([500_000.0, 5_400_000.0, 100.0])
WKT = 'LOCAL_CS["site",UNIT["metre",1]]'


@pytest.fixture
def cloud():
    rng = np.random.default_rng(0)
    count = 400
    return Cloud(
        rng.uniform(-5, 5, (count, 3)) + UTM_M,
        colour=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        intensity=rng.integers(0, 60_000, count).astype(np.float64),
        normals=np.eye(3)[rng.integers(0, 3, count)],
        columns={"label": rng.integers(0, 9, count).astype(np.int32), "gps_time": np.arange(count)},
        offset_m=UTM_M,
        viewpoint_m=UTM_M + [1, 2, 3],
        crs=WKT,
    )


@pytest.mark.parametrize("extension", WRITABLE)
def test_what_is_written_is_read_again_to_a_tenth_of_a_millimetre(tmp_path, cloud, extension):
    path = tmp_path / f"scan{extension}"
    skipnet.write_cloud(path, cloud)
    again = skipnet.read_cloud(path)
    np.testing.assert_allclose(again.points_m, cloud.points_m, atol=6e-5, rtol=0)
    if extension == ".npy":
        assert again.holds == []
        return
    np.testing.assert_array_equal(again.colour, cloud.colour)
    np.testing.assert_allclose(again.intensity, cloud.intensity)
    if extension in (".pcd", ".e57", ".npz"):
        np.testing.assert_allclose(again.viewpoint_m, cloud.viewpoint_m, atol=1e-2)
    if extension != ".e57":
        np.testing.assert_allclose(again.normals, cloud.normals)
        for name, values in cloud.columns.items():
            np.testing.assert_allclose(again.columns[name], values)
    if extension in (".las", ".laz"):
        assert again.crs == WKT and again.offset_m.tolist() == UTM_M.tolist()


@pytest.mark.parametrize("extension", ["las", "laz"])
def test_laspy_reads_what_we_write(tmp_path, cloud, extension):
    laspy = pytest.importorskip("laspy")
    skipnet.write_cloud(tmp_path / f"a.{extension}", cloud)
    las = laspy.read(tmp_path / f"a.{extension}")
    np.testing.assert_allclose(las.xyz, cloud.points_m, atol=6e-5, rtol=0)
    np.testing.assert_array_equal(las.red >> 8, cloud.colour[:, 0])
    np.testing.assert_array_equal(las["label"], cloud.columns["label"])
    assert las.header.vlrs.get("WktCoordinateSystemVlr")[0].string == WKT


def test_pye57_and_open3d_read_what_we_write(tmp_path, cloud):
    import open3d as o3d

    pye57 = pytest.importorskip("pye57")
    skipnet.write_cloud(tmp_path / "a.e57", cloud)
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        scan = file.read_scan(0, intensity=True, colors=True, ignore_missing_fields=True)
        np.testing.assert_allclose(file.scan_position(0)[0], cloud.viewpoint_m)
    np.testing.assert_allclose(scan["cartesianY"], cloud.points_m[:, 1], atol=1e-6, rtol=0)
    np.testing.assert_array_equal(scan["colorGreen"], cloud.colour[:, 1])
    skipnet.write_cloud(tmp_path / "a.ply", cloud)
    read = o3d.io.read_point_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(np.asarray(read.points), cloud.points_m)
    np.testing.assert_allclose(np.asarray(read.normals), cloud.normals)


def test_scans_of_an_e57_keep_their_poses(tmp_path, cloud):
    T_other = make_transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), [7.0, 0, 0])
    write_scans(tmp_path / "site.e57", [cloud, cloud.moved(T_other)])
    scans = read_scans(tmp_path / "site.e57")
    assert [len(scan) for scan in scans] == [len(cloud)] * 2
    np.testing.assert_allclose(scans[1].viewpoint_m, cloud.moved(T_other).viewpoint_m)
    assert skipnet.read_cloud(tmp_path / "site.e57").viewpoint_m is None


def test_a_turned_pose_of_an_e57_is_applied(tmp_path):
    pye57 = pytest.importorskip("pye57")
    local_m = np.array([[1.0, 0, 0], [0, 2, 0], [0, 0, 3]])
    turn = np.sqrt(0.5) * np.array([1.0, 0, 0, 1])  # a quarter about z
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), local_m.T.copy(), strict=True))
    columns |= {"rowIndex": np.arange(3, dtype=np.uint16), "columnIndex": np.zeros(3, np.uint16)}
    file.write_scan_raw(columns, rotation=turn, translation=np.array([10.0, 20, 0]))
    file.close()
    [scan] = read_scans(tmp_path / "a.e57")
    np.testing.assert_allclose(scan.points_m, [[10, 21, 0], [8, 20, 0], [10, 20, 3]], atol=1e-12)
    assert scan.viewpoint_m.tolist() == [10, 20, 0]
    assert scan.columns["rowIndex"].tolist() == [0, 1, 2]


def test_a_ptx_of_two_scans(tmp_path):
    head = "2\n2\n{0} 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n{0} 0 0 1\n"
    rows = "1 0 0 0.5 255 0 0\n0 0 0 0.5 0 0 0\n0 1 0 0.5 0 255 0\n0 0 1 0.5 0 0 255\n"
    (tmp_path / "a.ptx").write_text(head.format(0) + rows + head.format(10) + rows)
    first, second = read_scans(tmp_path / "a.ptx")
    assert first.viewpoint_m is None and second.viewpoint_m.tolist() == [10, 0, 0]
    assert second.points_m.tolist() == [[11, 0, 0], [10, 1, 0], [10, 0, 1]]
    assert second.colour.tolist() == (255 * np.eye(3, dtype=int)).tolist()
    assert second.notes == ("left out 1 of 4 beams that met nothing",)


def test_moving_and_joining_clouds(cloud):
    T = make_transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), [1.0, 2, 3])
    moved = cloud.moved(T)
    np.testing.assert_allclose(moved.normals, cloud.normals @ T[:3, :3].T)
    np.testing.assert_allclose(moved.points_m[0], T[:3, :3] @ cloud.points_m[0] + T[:3, 3])
    joined = concatenate([cloud, moved[:10]])
    assert len(joined) == len(cloud) + 10 and joined.viewpoint_m is None
    assert joined.columns["label"][-1] == cloud.columns["label"][9]
    assert concatenate([cloud, Cloud(cloud.points_m)]).colour is None


@pytest.mark.parametrize("unit", ["mm", "ft"])
def test_a_unit_is_converted_and_written_again(tmp_path, unit):
    metres = {"mm": 0.001, "ft": 0.3048}[unit]
    points = np.arange(12.0).reshape(4, 3)
    np.save(tmp_path / "a.npy", points)
    cloud = skipnet.read_cloud(tmp_path / "a.npy", unit=unit)
    np.testing.assert_allclose(cloud.points_m, points * metres)
    skipnet.write_cloud(tmp_path / "b.npy", cloud)
    np.testing.assert_allclose(np.load(tmp_path / "b.npy"), points, atol=1e-12)
    skipnet.write_cloud(tmp_path / "b.csv", cloud)
    named = skipnet.read_cloud(tmp_path / "b.csv")
    assert named.unit == unit
    np.testing.assert_allclose(named.points_m, points * metres, atol=1e-5)


def las_with_wkt(path, wkt, points):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = [1e-6] * 3
    las.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    las.x, las.y, las.z = np.transpose(points)
    las.write(path)
    return path


def test_feet_of_a_las_are_converted_and_written_again(tmp_path):
    wkt = 'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",{}]]'
    points = [[10.0, 20, 30], [40, 50, 60], [1, 2, 4]]
    for factor, unit in ((0.3048006096012192, "us_ft"), (0.3048, "ft"), (1, "m")):
        path = las_with_wkt(tmp_path / "a.las", wkt.format(factor), points)
        cloud = skipnet.read_cloud(path)
        assert cloud.unit == unit
        np.testing.assert_allclose(cloud.points_m, np.multiply(points, factor), atol=1e-6)
        skipnet.write_cloud(tmp_path / "b.laz", cloud)
        again = pytest.importorskip("laspy").read(tmp_path / "b.laz")
        np.testing.assert_allclose(again.xyz, points, atol=2e-4)


def test_degrees_are_refused_unless_they_cannot_be_such(tmp_path):
    wkt = 'GEOGCS["WGS 84",UNIT["degree",0.0174532925199433]]'
    site = [[8.4, 49.0, 100], [8.401, 49.001, 130], [8.402, 49, 140]]
    with pytest.raises(ValueError, match="degrees of longitude"):
        skipnet.read_cloud(las_with_wkt(tmp_path / "a.las", wkt, site))
    room = [[0.0, 0, 0], [5, 4, 3], [5, 0, 0]]
    assert skipnet.read_points(las_with_wkt(tmp_path / "b.las", wkt, room)).tolist() == room


def test_viewpoints_far_from_everything_are_not_believed(tmp_path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    skipnet.write_cloud(tmp_path / "a.pcd", Cloud(points, viewpoint_m=np.array([5e5, 0, 0])))
    cloud = skipnet.read_cloud(tmp_path / "a.pcd")
    assert cloud.viewpoint_m is None and "is not used" in cloud.notes[-1]


def test_negative_intensities_of_pts_files_stay_apart_in_las(tmp_path):
    pytest.importorskip("laspy")
    intensity = np.array([-2048.0, -1000, 0, 2047])
    skipnet.write_cloud(tmp_path / "a.las", Cloud(np.eye(4)[:, :3], intensity=intensity))
    read = skipnet.read_cloud(tmp_path / "a.las").intensity
    np.testing.assert_array_equal(read, intensity + 2048)


def test_a_cloud_and_its_skip_map_print_as_sentences():
    cloud = Cloud(np.zeros((1200, 3)), intensity=np.zeros(1200), name="a.ply")
    assert str(cloud) == "a.ply: 1,200 points with intensity"
    assert repr(cloud) == f"<Cloud {cloud}>"
    plane = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), axis=-1).reshape(-1, 3)
    assert str(skipnet.build_skipmap(plane, 2.0)).endswith("effective voxels of 2 m")


@pytest.mark.parametrize("extension", ["ply", "las", "laz"])
def test_the_sensors_place_and_the_coordinate_system_come_back(tmp_path, extension):
    points_m = np.random.default_rng(3).normal(size=(400, 3)) + [4e5, 5e6, 20.0]
    place_m = points_m.mean(axis=0) + 0.123456789
    written = Cloud(points_m, viewpoint_m=place_m, crs='PROJCS["Österreich",\n UNIT["metre",1]]')
    path = tmp_path / f"a.{extension}"
    skipnet.write_cloud(path, written)
    found = skipnet.read_cloud(path)
    np.testing.assert_array_equal(found.viewpoint_m, place_m)
    assert found.crs.split() == written.crs.split()
    assert found.unit == "m"
    skipnet.write_cloud(path, Cloud(points_m))
    again = skipnet.read_cloud(path)
    assert again.viewpoint_m is None and again.crs == ""


@pytest.mark.parametrize("place", ["1 2", "a b c", "nan 0 0", "", "1 2 3 4"])
def test_a_place_in_a_ply_file_that_makes_no_sense_is_a_remark(tmp_path, place):
    path = tmp_path / "a.ply"
    head = f"ply\nformat ascii 1.0\ncomment skipnet viewpoint_m {place}\nelement vertex 2\n"
    columns = "".join(f"property float {axis}\n" for axis in "xyz")
    path.write_text(f"{head}{columns}end_header\n1 2 3\n4 5 6\n")
    cloud = skipnet.read_cloud(path)
    assert cloud.viewpoint_m is None
    np.testing.assert_array_equal(cloud.points_m, [[1, 2, 3], [4, 5, 6]])
