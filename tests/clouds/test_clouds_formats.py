"""Each format is written by an independent writer and read back; broken files say what is wrong."""

from __future__ import annotations

import logging
import struct

import numpy as np
import pytest

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats import reading as formats
from skipnet.clouds.formats.reading import SUPPORTED, read_chunks, read_points
from skipnet.clouds.formats.writing import write_cloud
from skipnet.storage import replacing


@pytest.fixture
def points():
    return np.random.default_rng(3).uniform(-5, 5, size=(50, 3)).round(4)


def open3d_cloud(points):
    import open3d as o3d

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


@pytest.mark.parametrize("extension", ["ply", "pcd"])
@pytest.mark.parametrize("options", [{"write_ascii": True}, {}, {"compressed": True}])
def test_reads_what_open3d_writes(tmp_path, points, extension, options):
    import open3d as o3d

    path = tmp_path / f"cloud.{extension}"
    assert o3d.io.write_point_cloud(path, open3d_cloud(points), **options)
    np.testing.assert_allclose(read_points(path), points, atol=1e-6)


def test_reads_a_hand_written_big_endian_ply_with_other_elements_and_columns(tmp_path):
    header = (
        b"ply\r\nformat binary_big_endian 1.0\r\ncomment by hand\r\n"
        b"element camera 1\r\nproperty int id\r\n"
        b"element vertex 2\r\nproperty uchar red\r\n"
        b"property float x\r\nproperty float y\r\nproperty double z\r\n"
        b"element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n"
    )
    body = (
        struct.pack(">i", 7)
        + struct.pack(">Bffd", 255, 1, 2, 3)
        + struct.pack(">Bffd", 0, -1, -2, -3)
    )
    path = tmp_path / "big.ply"
    path.write_bytes(header + body + struct.pack(">Biii", 3, 0, 1, 0))
    np.testing.assert_array_equal(read_points(path), [[1, 2, 3], [-1, -2, -3]])


def test_open3d_reads_what_we_write(tmp_path, points):
    import open3d as o3d

    path = tmp_path / "ours.ply"
    colors = np.random.default_rng(0).integers(0, 256, size=points.shape)
    write_cloud(path, Cloud(points, colour=colors.astype(np.uint8)))
    cloud = o3d.io.read_point_cloud(path)
    np.testing.assert_array_equal(np.asarray(cloud.points), points)
    np.testing.assert_allclose(np.asarray(cloud.colors) * 255, colors, atol=1e-9)
    np.testing.assert_array_equal(read_points(path), points)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.xyz", "1 2 3\n4 5 6\n"),
        ("a.txt", "# x y z i\n1\t2\t3\t9\n\n4\t5\t6\t9\n"),
        ("a.csv", "1,2,3\n4,5,6\n"),
        ("a.CSV", "1;2;3\n4;5;6"),
        ("a.csv", '"i","X","Y","Z"\n9,1,2,3\n9,4,5,6\n'),
        ("a.xyz", "\ufeffz y x\n3 2 1\n6 5 4\n"),
    ],
)
def test_reads_text(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_points(tmp_path / name), [[1, 2, 3], [4, 5, 6]])


def test_reads_numpy(tmp_path, points):
    np.save(tmp_path / "a.npy", points.astype(np.float32))
    np.savez(tmp_path / "one.npz", cloud=points)
    np.savez_compressed(tmp_path / "many.npz", other=np.zeros(3), points=points)
    np.testing.assert_allclose(read_points(tmp_path / "a.npy"), points, atol=1e-6)
    for name in ("one.npz", "many.npz"):
        np.testing.assert_array_equal(read_points(tmp_path / name), points)


@pytest.mark.parametrize("extension", ["ply", "las", "laz"])
def test_large_files_are_read_and_written_in_chunks(tmp_path, points, extension, monkeypatch):
    for module in ("ply", "las"):
        monkeypatch.setattr(f"skipnet.clouds.formats.{module}.RECORDS_AT_ONCE", 7)
    path = tmp_path / f"scan.{extension}"
    if extension == "ply":
        write_cloud(path, map(Cloud, np.array_split(points, 3)))
    else:
        laspy = pytest.importorskip("laspy")
        cloud = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
        cloud.header.scales = [1e-6] * 3
        cloud.x, cloud.y, cloud.z = points.T
        cloud.write(str(path))
    chunks = [chunk.points_m for chunk in read_chunks(path)]
    assert {len(chunk) for chunk in chunks[:-1]} == {7} and len(chunks) > 2
    np.testing.assert_allclose(np.concatenate(chunks), points, atol=1e-6)
    np.testing.assert_array_equal(read_points(path), np.concatenate(chunks))


@pytest.mark.parametrize("extension", ["las", "laz"])
def test_reads_las(tmp_path, points, extension):
    laspy = pytest.importorskip("laspy")
    far = points + [500000, 5400000, 0]  # surveyed coordinates keep their millimetres
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.scales, las.header.offsets = [1e-4] * 3, far.min(axis=0)
    las.x, las.y, las.z = far.T
    path = tmp_path / f"a.{extension}"
    las.write(path)
    np.testing.assert_allclose(read_points(path), far, atol=1e-4)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match="truncated"):
        read_points(path)


def test_reads_all_scans_of_an_e57_in_one_frame(tmp_path, points):
    pye57 = pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    file = pye57.E57(str(path), mode="w")
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), points.T, strict=True))
    file.write_scan_raw(columns)
    file.write_scan_raw(columns, translation=np.array([100.0, 0, 0]))
    file.close()
    np.testing.assert_allclose(
        read_points(path), np.concatenate([points, points + [100, 0, 0]]), atol=1e-9
    )
    path.write_bytes(path.read_bytes()[:600])
    with pytest.raises(ValueError, match="truncated"):
        read_points(path)


def test_rows_without_a_return_in_a_pcd_are_dropped_and_reported(tmp_path, points, caplog):
    import open3d as o3d

    path = tmp_path / "organised.pcd"
    with_gaps = points.copy()
    with_gaps[::5] = np.nan
    o3d.io.write_point_cloud(path, open3d_cloud(with_gaps))
    with caplog.at_level(logging.INFO):
        kept = read_points(path)
    np.testing.assert_allclose(kept, with_gaps[~np.isnan(with_gaps[:, 0])], atol=1e-6)
    assert "dropped 10 of 50" in caplog.text


PLY = b"ply\nformat ascii 1.0\n"
BROKEN = {
    "empty.ply": (b"", "is empty"),
    "noise.ply": (b"\x89ONG\r\n\x1a\n" + bytes(100), "not a PLY"),
    "picture.ply": (b"\x89PNG\r\n\x1a\n" + bytes(100), "no depth image"),
    "header.ply": (PLY + b"element vertex 3\n", "header never ends"),
    "format.ply": (
        b"ply\nformat ascii_art 1.0\nelement vertex 1\nend_header\n1 2 3\n",
        "unknown PLY format",
    ),
    "bare.ply": (PLY + b"element vertex 1\nproperty\nend_header\n1\n", "cannot read the header"),
    "count.ply": (
        PLY
        + b"element vertex 99999999999\nproperty float x\nproperty float y\nproperty float z\n"
        + b"end_header\n1 2 3\n",
        "truncated",
    ),
    "mesh.ply": (PLY + b"element face 0\nproperty int a\nend_header\n", "no vertices"),
    "flat.ply": (PLY + b"element vertex 1\nproperty float x\nend_header\n1\n", "lacks x, y or z"),
    "none.ply": (
        PLY
        + b"element vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        "holds no points",
    ),
    "noise.pcd": (b"hello\n", "not a PCD"),
    "flat.pcd": (b"FIELDS x y\nPOINTS 2\nDATA ascii\n1 2\n3 4\n", "lack x, y or z"),
    "widths.pcd": (
        b"FIELDS x y z\nCOUNT a b c\nPOINTS 1\nDATA ascii\n1 2 3\n",
        "whole numbers after COUNT",
    ),
    "letters.xyz": (b"these are\nnot numbers\n", "neither numbers nor"),
    "row.txt": (b"".join(b"%d %d.5 2.25 3.5\n" % (i, i) for i in range(20)), "counts the lines"),
    "binary.xyz": (b"\xff\xfe\x00\x81", "not a text file"),
    "two.csv": (b"1,2\n3,4\n", "at least three numbers"),
    "cut.xyz": (b"1 2 3\n4 5 6\n7 8", "at least three numbers"),
    "comment.txt": (b"# nothing else\n", "holds no points"),
    "head.csv": (b"x,y,z\n", "holds no points"),
    "noise.npy": (b"not numpy at all", "not a NumPy"),
    "noise.npz": (b"PK\x03\x04 broken", "not a NumPy"),
    "points.doc": (b"v 1 2 3\n", "unknown extension"),
    "points": (b"hello\n", "unknown extension"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_by_name(tmp_path, name):
    content, words = BROKEN[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=words) as refusal:
        read_points(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value).strip()


@pytest.mark.parametrize("extension", ["ply", "pcd"])
@pytest.mark.parametrize("ascii_", [True, False])
def test_truncated_files_are_refused(tmp_path, points, extension, ascii_):
    import open3d as o3d

    path = tmp_path / f"cut.{extension}"
    o3d.io.write_point_cloud(path, open3d_cloud(points), write_ascii=ascii_)
    path.write_bytes(path.read_bytes()[:-400])
    with pytest.raises(ValueError, match="truncated"):
        read_points(path)


def test_arrays_that_are_no_points_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((5, 2)))
    np.savez(tmp_path / "b.npz", a=np.zeros((5, 3)), b=np.zeros((5, 3)))
    for name, words in (("a.npy", r"shape \(5, 2\)"), ("b.npz", "called 'points'")):
        with pytest.raises(ValueError, match=words):
            read_points(tmp_path / name)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_points(tmp_path / "nowhere.ply")
    with pytest.raises(ValueError, match="folder"):
        read_points(tmp_path)


def test_a_missing_package_is_named_with_its_pip_command(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    (tmp_path / "a.las").write_bytes(b"LASF")
    with pytest.raises(ModuleNotFoundError, match=r"laspy: pip install 'skipnet\[formats\]'"):
        read_points(tmp_path / "a.las")


def test_the_supported_extensions_are_those_of_the_readers():
    assert set(SUPPORTED) == set(formats._READERS)
    expected = "ply pcd xyz txt csv asc pts ptx npy npz las laz e57 bin obj stl glb off png"
    assert {f".{name}" for name in expected.split()} == set(SUPPORTED)


def test_a_failed_write_leaves_the_old_file_alone(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half of the n")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
