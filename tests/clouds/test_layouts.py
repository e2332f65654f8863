"""Files as other programs lay them out, a few bytes each."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import skipnet
from skipnet.clouds.formats.reading import read_scans

POINTS = [[1, 2, 3], [4, 5, 6.5]]
TEXTS = {
    "count line": "2\n1 2 3\n4 5 6.5\n",
    "pts with colours": "2\n1 2 3 -100 255 0 0\n4 5 6.5 200 0 255 7\n",
    "CloudCompare": "//X,Y,Z,R,G,B,Intensity\n1,2,3,255,0,0,-100\n4,5,6.5,0,255,7,200\n",
    "CloudCompare with blanks": "//X Y Z\n1 2 3\n4 5 6.5\n",
    "comments": "# made by hand\n# columns: x y z and more words\n1 2 3\n\n// half way\n4 5 6.5\n",
    "named columns": "id\tname\tX\tY\tZ\n7\tstone\t1\t2\t3\n8\ttree\t4\t5\t6.5\n",
    "units in brackets": "x [m] y [m] z [m]\n1 2 3\n4 5 6.5\n",
    "millimetres": "X (mm);Y (mm);Z (mm)\n1000;2000;3000\n4000;5000;6500\n",
    "decimal commas": "1,0 2,0 3,0\n4,0 5,0 6,5\n",
    "decimal commas and semicolons": "x;y;z\n1,0;2,0;3,0\n4,0;5,0;6,5\n",
    "names of points": "P1,1,2,3\nP2,4,5,6.5\n",
    "quotes": '"x","y","z"\n"1","2","3"\n"4","5","6.5"\n',
    "a delimiter at the end": "1,2,3,\n4,5,6.5,\n",
    "Windows": "x y z\r\n1 2 3\r\n4 5 6.5\r\n",
    "exponents": "1e0 2.0E+0 3\n4 5 65e-1\n",
    "eastings": "Easting,Northing,Elevation\n1,2,3\n4,5,6.5\n",
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("extension", ["txt", "pts", "xyz", "csv", "asc"])
def test_text(tmp_path, name, extension):
    path = tmp_path / f"a.{extension}"
    path.write_text(TEXTS[name], newline="")
    cloud = skipnet.read_cloud(path)
    np.testing.assert_allclose(cloud.points_m, POINTS)
    if "100" in TEXTS[name] and "255" in TEXTS[name]:
        assert cloud.colour.tolist() == [[255, 0, 0], [0, 255, 7]]
        assert cloud.intensity.tolist() == [-100, 200]


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
def test_text_in_other_encodings(tmp_path, encoding):
    (tmp_path / "a.txt").write_bytes("x y z Höhe\n1 2 3 0\n4 5 6.5 0\n".encode(encoding))
    cloud = skipnet.read_cloud(tmp_path / "a.txt")
    assert cloud.points_m.tolist() == POINTS and "Höhe" in cloud.columns


def test_blocks_of_a_pts_file_are_all_read(tmp_path):
    (tmp_path / "a.pts").write_text("1\n1 2 3 0\n1\n4 5 6.5 0\n")
    assert skipnet.read_points(tmp_path / "a.pts").tolist() == POINTS


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (lambda i: f"{i} {i + 0.5} 2.25 3.5", "column 1 counts the lines"),
        (lambda i: f"{i % 4} {i // 4} {i + 0.5} 2.25", "column 1 holds whole numbers"),
        (lambda i: f"{i % 7} {i * 0.37} 2.25 3.5", "column 1 holds whole numbers"),
    ],
)
def test_columns_that_cannot_be_coordinates_are_refused(tmp_path, rows, words):
    (tmp_path / "a.txt").write_text("\n".join(map(rows, range(20))))
    with pytest.raises(ValueError, match=words):
        skipnet.read_points(tmp_path / "a.txt")


def test_unnamed_columns_are_told_apart_and_said(tmp_path):
    rng = np.random.default_rng(0)
    xyz, rgb = rng.normal(size=(30, 3)), rng.integers(0, 256, (30, 3))
    normals = xyz / np.linalg.norm(xyz, axis=1, keepdims=True)
    for columns, names in (
        ([xyz, rgb], "x, y, z, red, green, blue"),
        ([xyz, normals], "x, y, z, nx, ny, nz"),
        ([xyz, rgb, normals], "x, y, z, red, green, blue, nx, ny, nz"),
        ([xyz, rng.normal(size=(30, 1))], "x, y, z, intensity"),
    ):
        np.savetxt(tmp_path / "a.xyz", np.column_stack(columns))
        assert skipnet.read_cloud(tmp_path / "a.xyz").notes == (f"columns taken as {names}",)


def ply(header, body, order="binary_little_endian"):
    return f"ply\nformat {order} 1.0\n{header}end_header\n".encode() + body


XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "element face {}\nproperty list uchar int vertex_indices\n"
PLYS = {
    "lists among the properties": ply(
        f"element vertex 2\nproperty list uchar uchar tags\n{XYZ}",
        struct.pack("<B2B3f", 2, 8, 9, 1, 2, 3) + struct.pack("<B3f", 0, 4, 5, 6.5),
    ),
    "lists of one length": ply(
        f"element vertex 2\nproperty list uchar uchar tags\n{XYZ}",
        struct.pack("<B2B3f", 2, 8, 9, 1, 2, 3) + struct.pack("<B2B3f", 2, 7, 7, 4, 5, 6.5),
    ),
    "faces first": ply(
        f"{FACES.format(2)}element vertex 2\n{XYZ}",
        struct.pack("<B3i", 3, 0, 1, 0) + struct.pack("<B4i", 4, 0, 1, 0, 1)
        + struct.pack("<6f", 1, 2, 3, 4, 5, 6.5),
    ),
    "faces first, ascii": ply(
        f"{FACES.format(1)}element vertex 2\n{XYZ}", b"3 0 1 0\n1 2 3\n4 5 6.5\n", "ascii"
    ),
    "lists, ascii": ply(
        f"element vertex 2\nproperty list uchar int t\n{XYZ}", b"2 8 9 1 2 3\n0 4 5 6.5\n", "ascii"
    ),
    "capitals": b"PLY\nFORMAT ascii 1.0\nELEMENT Vertex 2\nPROPERTY FLOAT X\nproperty float Y\n"
    b"property float Z\nEND_HEADER\n1 2 3\n4 5 6.5\n",
    "big-endian": ply(
        f"element vertex 2\n{XYZ}", struct.pack(">6f", 1, 2, 3, 4, 5, 6.5), "binary_big_endian"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PLYS)
def test_ply(tmp_path, name):
    (tmp_path / "a.ply").write_bytes(PLYS[name])
    assert skipnet.read_points(tmp_path / "a.ply").tolist() == POINTS


def test_content_decides_over_the_extension(tmp_path):
    for name in ("a.pcd", "a.xyz", "a", "a.las"):
        (tmp_path / name).write_bytes(PLYS["big-endian"])
        assert skipnet.read_points(tmp_path / name).tolist() == POINTS
    for name in ("b.ply", "b", "b.dat"):
        (tmp_path / name).write_text("1 2 3\n4 5 6.5\n")
        assert skipnet.read_points(tmp_path / name).tolist() == POINTS


def pcd(kind, size, data, body, count=2, extra=""):
    head = f"VERSION .7\nFIELDS x y z{extra and ' ' + extra.split()[0]}\nSIZE {size}\nTYPE {kind}\n"
    counts = " ".join("1" for _ in size.split())
    return (head + f"COUNT {counts}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 1 1 1 1 0 0 0\n"
            f"POINTS {count}\nDATA {data}\n").encode() + body  # fmt: skip


@pytest.mark.parametrize("kind", ["f", "d"])
def test_pcd_of_4_and_8_bytes(tmp_path, kind):
    size = struct.calcsize(kind)
    body = struct.pack(f"<6{kind}", 1, 2, 3, 4, 5, 6.5)
    columns = struct.pack(f"<6{kind}", 1, 4, 2, 5, 3, 6.5)
    halves = columns[: len(columns) // 2], columns[len(columns) // 2 :]
    packed = b"".join(bytes([len(half) - 1]) + half for half in halves)  # all bytes as they are
    compressed = struct.pack("<II", len(packed), len(columns)) + packed
    for data, content in (
        ("binary", body),
        ("ASCII", b"1 2 3\n4 5 6.5\n"),
        ("binary_compressed", compressed),
    ):
        (tmp_path / "a.pcd").write_bytes(pcd("F F F", f"{size} {size} {size}", data, content))
        cloud = skipnet.read_cloud(tmp_path / "a.pcd")
        assert cloud.points_m.tolist() == POINTS
        assert cloud.viewpoint_m.tolist() == [1, 1, 1]


def test_ascii_pcd_keeps_all_digits_of_its_text(tmp_path):
    (tmp_path / "a.pcd").write_bytes(
        pcd("F F F", "4 4 4", "ascii", b"4512345.678 5401234.567 1\n0 0 0\n")
    )
    assert skipnet.read_points(tmp_path / "a.pcd")[0].tolist() == [4512345.678, 5401234.567, 1]


@pytest.mark.parametrize("kind", ["F", "U"])
def test_packed_colours_of_a_pcd(tmp_path, kind):
    body = b"".join(struct.pack("<3fI", *row, 0x00FF8001) for row in POINTS)
    (tmp_path / "a.pcd").write_bytes(
        pcd(f"F F F {kind}", "4 4 4 4", "binary", body, extra="rgb 4 F")
    )
    assert skipnet.read_cloud(tmp_path / "a.pcd").colour.tolist() == [[255, 128, 1]] * 2


def test_open3d_s_colours_and_normals_of_a_pcd(tmp_path):
    import open3d as o3d

    rng = np.random.default_rng(0)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(rng.normal(size=(300, 3))))
    colours = rng.integers(0, 256, (300, 3))
    cloud.colors = o3d.utility.Vector3dVector(colours / 255)
    cloud.normals = o3d.utility.Vector3dVector(np.tile([0.0, 0, 1], (300, 1)))
    for options in ({"write_ascii": True}, {}, {"compressed": True}):
        o3d.io.write_point_cloud(tmp_path / "a.pcd", cloud, **options)
        read = skipnet.read_cloud(tmp_path / "a.pcd")
        np.testing.assert_allclose(read.points_m, np.asarray(cloud.points), atol=1e-6)
        np.testing.assert_array_equal(read.colour, colours)
        np.testing.assert_allclose(read.normals, [[0, 0, 1]] * 300)


@pytest.mark.parametrize("points", [60, 3000])
@pytest.mark.parametrize(
    ("names", "scales"),
    [
        (["x", "y", "z", "intensity"], [30, 30, 2, 1]),
        (["x", "y", "z"], [4, 4, 1.5]),
        (["x", "y", "z", "red", "green", "blue"], [4, 4, 1.5, 256, 256, 256]),
        (["x", "y", "z", "red", "green", "blue"], [4, 4, 1.5, 1, 1, 1]),
        (["x", "y", "z", "intensity", "elongation", "time"], [30, 30, 2, 1, 1, 1e15]),
        (["x", "y", "z", "intensity", "elongation"], [30, 30, 2, 1, 1]),
    ],
)
def test_how_many_numbers_a_raw_record_has_is_found_out(tmp_path, points, names, scales):
    rng = np.random.default_rng(points + len(names))
    table = rng.random((12 * (points // 12), len(names))) * scales
    table[:, 3:] = np.floor(table[:, 3:]) if max(scales) == 256 else table[:, 3:]
    table[:, :3] -= np.array(scales[:3]) / 2
    table.astype("<f4").tofile(tmp_path / "a.bin")
    cloud = skipnet.read_cloud(tmp_path / "a.bin")
    np.testing.assert_allclose(cloud.points_m, table[:, :3], atol=1e-5)
    assert ("red" in names) == (cloud.colour is not None)
    if "intensity" in names:
        np.testing.assert_allclose(cloud.intensity, table[:, 3], atol=1e-6)


def test_a_few_raw_points_are_no_evidence_for_a_longer_record(tmp_path):
    points = np.array([[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5], [1, 0.5, 0], [0.5, 1, 0], [1, 1, 0]])
    points.astype("<f4").tofile(tmp_path / "a.bin")
    assert skipnet.read_points(tmp_path / "a.bin").tolist() == points.tolist()


def test_a_first_row_of_nan_stops_nobody(tmp_path):
    (tmp_path / "a.xyz").write_text("NaN NaN NaN\nnan nan nan\n1 2 3\n4 5 6.5\n")
    cloud = skipnet.read_cloud(tmp_path / "a.xyz")
    assert cloud.points_m.tolist() == POINTS and "dropped 2 of 4" in cloud.notes[0]


def test_colours_beside_three_arrays_of_coordinates(tmp_path):
    x, y, z = np.array(POINTS).T
    colours = np.array([[1, 2, 3], [200, 5, 6]], np.uint8)
    np.savez(tmp_path / "a.npz", x=x, y=y, z=z, rgb=colours)
    assert skipnet.read_cloud(tmp_path / "a.npz").colour.tolist() == colours.tolist()


def test_labels_are_no_raw_points(tmp_path):
    labels = np.random.default_rng(0).integers(0, 40, 240)
    for kind in ("<i8", "<i4", "<u2"):
        labels.astype(kind).tofile(tmp_path / "a.bin")
        with pytest.raises(ValueError, match="not KITTI's layout"):
            skipnet.read_points(tmp_path / "a.bin")


def test_a_ply_file_of_pyntcloud_with_a_column_of_bool(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\n"
    body = "property double z\nproperty bool is_floor\nend_header\n1 2 3 1\n4 5 6.5 0\n"
    (tmp_path / "a.ply").write_text(head + body)
    cloud = skipnet.read_cloud(tmp_path / "a.ply")
    assert cloud.points_m.tolist() == POINTS and cloud.columns["is_floor"].tolist() == [1, 0]


def test_normals_as_pdal_and_cloudcompare_call_them(tmp_path):
    rows = "1,2,3,0,0,1\n4,5,6.5,1,0,0\n"
    (tmp_path / "a.csv").write_text('"X","Y","Z","NormalX","NormalY","NormalZ"\n' + rows)
    assert skipnet.read_cloud(tmp_path / "a.csv").normals.tolist() == [[0, 0, 1], [1, 0, 0]]


def test_kitti(tmp_path):
    np.array([[1, 2, 3, 0.5], [4, 5, 6.5, 1]], "<f4").tofile(tmp_path / "000000.bin")
    cloud = skipnet.read_cloud(tmp_path / "000000.bin")
    assert cloud.points_m.tolist() == POINTS and cloud.intensity.tolist() == [0.5, 1]
    (tmp_path / "b.bin").write_bytes(b"\xff" * 160)
    with pytest.raises(ValueError, match="not KITTI's layout"):
        skipnet.read_points(tmp_path / "b.bin")


@pytest.mark.parametrize("kind", ["fx", "open3d", "text", "none"])
def test_a_depth_image_with_its_camera(tmp_path, kind):
    from PIL import Image

    depth = np.zeros((4, 6), np.uint16)
    depth[3, 5], depth[0, 0] = 2000, 1000
    (tmp_path / "frames").mkdir()
    Image.fromarray(depth).save(tmp_path / "frames" / "1.png")
    rows = [[2.0, 0, 3], [0, 4, 1], [0, 0, 1]]
    if kind == "fx":
        (tmp_path / "intrinsics.json").write_text('{"fx": 2, "fy": 4, "cx": 3, "cy": 1}')
    elif kind == "open3d":
        matrix = np.array(rows).T.ravel().tolist()
        (tmp_path / "frames" / "1.json").write_text(f'{{"intrinsic_matrix": {matrix}}}')
    elif kind == "text":
        np.savetxt(tmp_path / "camera-intrinsics.txt", rows)
    else:
        with pytest.raises(FileNotFoundError, match="needs its camera's intrinsics"):
            skipnet.read_cloud(tmp_path / "frames" / "1.png")
        return
    cloud = skipnet.read_cloud(tmp_path / "frames" / "1.png")
    assert cloud.points_m.tolist() == [[-1.5, -0.25, 1], [2, 1, 2]]
    assert cloud.viewpoint_m.tolist() == [0, 0, 0]
    assert cloud.notes == ("left out 22 of 24 pixels that saw nothing",)


@pytest.mark.parametrize("key", ["points", "xyz", "pos", "anything"])
def test_npz_with_what_stands_beside_the_points(tmp_path, key):
    beside = {} if key == "anything" else {"colors": np.array([[1.0, 0, 0], [0, 1, 0]])}
    beside |= {} if key == "anything" else {"labels": np.array([3, 4]), "name": np.array("x")}
    np.savez(tmp_path / "a.npz", **{key: np.array(POINTS)}, **beside)
    cloud = skipnet.read_cloud(tmp_path / "a.npz")
    assert cloud.points_m.tolist() == POINTS
    if beside:
        assert cloud.colour.tolist() == [[255, 0, 0], [0, 255, 0]]
        assert cloud.columns["labels"].tolist() == [3, 4]


def test_numpy_records_pixels_and_columns(tmp_path):
    records = np.array([(1, 2, 3, 9), (4, 5, 6.5, 9)], [(n, "f8") for n in ("x", "y", "z", "i")])
    np.save(tmp_path / "a.npy", records)
    assert skipnet.read_cloud(tmp_path / "a.npy").intensity.tolist() == [9, 9]
    np.save(tmp_path / "b.npy", np.array(POINTS).reshape(2, 1, 3))
    np.savez(tmp_path / "c.npz", x=[1, 4], y=[2, 5], z=[3, 6.5])
    for name in ("a.npy", "b.npy", "c.npz"):
        assert skipnet.read_points(tmp_path / name).tolist() == POINTS


@pytest.mark.parametrize("kind", ["obj", "stl", "glb", "off", "ply"])
def test_a_box_of_a_mesh_is_sampled_and_said_to_be(tmp_path, kind):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((2.0, 1.0, 1.0)).export(tmp_path / f"box.{kind}")
    cloud = skipnet.read_cloud(tmp_path / f"box.{kind}")
    assert any("12 triangles: sampled" in note for note in cloud.notes)
    np.testing.assert_allclose(np.abs(cloud.points_m).max(axis=0), [1, 0.5, 0.5], atol=1e-6)
    on_a_face = np.isclose(np.abs(cloud.points_m), [1, 0.5, 0.5], atol=1e-6).any(axis=1)
    assert on_a_face.all()
    # A tenth of the surface is each end of the box, whose sides are twice as long.
    assert abs(np.isclose(cloud.points_m[:, 0], 1).mean() - 0.1) < 0.01


def test_an_obj_of_points_alone(tmp_path):
    pytest.importorskip("trimesh")
    (tmp_path / "a.obj").write_text("v 1 2 3\nv 4 5 6.5\n")
    assert skipnet.read_points(tmp_path / "a.obj").tolist() == POINTS


def test_rows_of_nan_are_dropped_and_said(tmp_path):
    np.save(tmp_path / "a.npy", [*POINTS, [np.nan, 0, 0], [np.inf, 1, 1]])
    [cloud] = read_scans(tmp_path / "a.npy")
    assert cloud.points_m.tolist() == POINTS
    assert cloud.notes == ("dropped 2 of 4 rows without a finite place",)


@pytest.mark.parametrize("unit", ["", "m"])
def test_large_coordinates_keep_their_millimetres(tmp_path, unit):
    rows = np.array([[4512345.6789, 5401234.5678, 456.789], [4512346.0, 5401234.0, 457.001]])
    np.savetxt(tmp_path / "a.csv", rows, "%.4f", ",", header=f"x{unit and ' [m]'},y,z", comments="")
    np.testing.assert_allclose(skipnet.read_points(tmp_path / "a.csv"), rows, atol=1e-9, rtol=0)
