"""Layouts as other programs write them, made here by their rules: read, with what stands beside."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import skipnet
from skipnet.clouds.formats.reading import read_scans

COUNT = 200
RNG = np.random.default_rng(3)
P = np.round(RNG.uniform(-8, 8, (COUNT, 3)), 3)
MAP = P + [512_345.0, 5_412_345, 312]
RGB = RNG.integers(0, 256, (COUNT, 3))
SHINE = RNG.integers(0, 4096, COUNT)
NORMALS = RNG.normal(size=(COUNT, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
NUMBER = np.arange(COUNT)
ROW, COLUMN = np.divmod(NUMBER, 20)


def lines(form, *columns):
    """One line per point; columns may be tables."""
    table = np.column_stack(columns)
    return "".join(form.format(*row) + "\n" for row in table)


XYZ, WHOLE3 = "{:.3f} {:.3f} {:.3f}", " {:.0f} {:.0f} {:.0f}"
HALVES = lines(XYZ.replace(" ", "\t"), P).splitlines(keepends=True)
VELO = '"Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2","intensity","laser_id"\n'
LIVOX = "Version,Slot ID,Error Code,Timestamp,X,Y,Z,Reflectivity,Ori_x,Ori_y,Ori_z\n"
TEXTS = {
    "CloudCompare": (
        "//X Y Z R G B Scalar_field Nx Ny Nz\n200\n"
        + lines(XYZ + WHOLE3 + " {:.0f} {:.6f} {:.6f} {:.6f}", P, RGB, SHINE, NORMALS),
        P, {"colour": RGB, "normals": NORMALS},
    ),
    "CloudCompare without names": (
        lines(XYZ + WHOLE3 + " {:.6f} {:.6f} {:.6f}", P, RGB, NORMALS),
        P, {"colour": RGB, "normals": NORMALS},
    ),
    "Riegl": (
        "X;Y;Z;Amplitude;Reflectance\n"
        + lines("{:.3f};{:.3f};{:.3f};{:.0f};{:.2f}", MAP, SHINE, SHINE / 100),
        MAP, {"intensity": SHINE / 100},
    ),
    "Trimble": (
        "".join(f"P{k},{x:.3f},{y:.3f},{z:.3f},WALL A\n" for k, (x, y, z) in enumerate(MAP)),
        MAP, {},
    ),
    "decimal commas in quotes": (
        '"Point";"Easting";"Northing";"Elevation"\r\n'
        + "".join(f'"P";"{x:.3f}";"{y:.3f}";"{z:.3f}"\r\n'.replace(".", ",") for x, y, z in MAP),
        MAP, {},
    ),
    "quoted names": (
        '\ufeff"X","Y","Z","Intensity"\r\n' + lines("{:.3f},{:.3f},{:.3f},{:.0f}", P, SHINE),
        P, {"intensity": SHINE},
    ),
    "tabs and a remark in the middle": (
        "".join([*HALVES[:90], "# the other half\n", "\n", *HALVES[90:]]), P, {},
    ),
    "Leica PTS": (
        f"{COUNT} \r\n" + lines(XYZ + " {:.0f}" + WHOLE3 + " \r", P, SHINE - 2048, RGB),
        P, {"colour": RGB},
    ),
    "Fortran": (lines("{:.6E} {:.6E} {:.6E}", P).replace("E", "D"), P, {}),
    "pandas": (",x,y,z,intensity\n" + lines("{:.0f},{:.3f},{:.3f},{:.3f},{:.0f}", NUMBER, P, SHINE),
               P, {"intensity": SHINE}),
    "pandas without names": ("0,1,2\n" + lines("{:.3f},{:.3f},{:.3f}", P), P, {}),
    "Ouster": (
        "TIMESTAMP (ns),RANGE (mm),X (mm),Y (mm),Z (mm),REFLECTIVITY\n"
        + lines("{:.0f},{:.0f},{:.0f},{:.0f},{:.0f},{:.0f}", NUMBER, SHINE, 1000 * P, SHINE),
        P, {"intensity": SHINE},
    ),
    "VeloView": (
        VELO + lines("{:.3f},{:.3f},{:.3f},{:.0f},{:.0f}", P, SHINE, ROW), P, {"intensity": SHINE},
    ),
    "Livox": (
        LIVOX + lines("5,1,0x00000000,{:.0f},{:.3f},{:.3f},{:.3f},{:.0f},{:.0f},{:.0f},{:.0f}",
                      1e9 + NUMBER, P, SHINE, 1000 * P),
        P, {"intensity": SHINE},
    ),
}  # fmt: skip


def assert_holds(cloud, points, beside):
    np.testing.assert_allclose(cloud.points_m, points, atol=1e-6, rtol=0)
    for name, values in beside.items():
        np.testing.assert_allclose(getattr(cloud, name), values, atol=1e-5)


@pytest.mark.parametrize("name", TEXTS)
def test_text(tmp_path, name):
    text, points, beside = TEXTS[name]
    (tmp_path / "a.txt").write_text(text, encoding="utf-8", newline="")
    assert_holds(skipnet.read_cloud(tmp_path / "a.txt"), points, beside)


def test_rows_and_columns_of_faro_are_refused_until_they_are_named(tmp_path):
    body = lines("{:.0f} {:.0f} " + XYZ + WHOLE3, ROW, COLUMN, P, RGB)
    (tmp_path / "a.xyz").write_text(body)
    with pytest.raises(ValueError, match="such as: row column x y z"):
        skipnet.read_cloud(tmp_path / "a.xyz")
    (tmp_path / "a.xyz").write_text("row column x y z r g b\n" + body)
    assert_holds(skipnet.read_cloud(tmp_path / "a.xyz"), P, {"colour": RGB})


PLY_KINDS = [("x", "f4"), ("y", "f4"), ("z", "f4"), *((c, "u1") for c in ("red", "green", "blue"))]


@pytest.mark.parametrize("first", [True, False])
def test_a_camera_among_the_elements_of_a_ply_file(tmp_path, first):
    """As MeshLab and multi-view stereo write it."""
    records = np.empty(COUNT, [(name, f"<{kind}") for name, kind in PLY_KINDS])
    for (name, _), values in zip(PLY_KINDS, np.column_stack([P, RGB]).T, strict=True):
        records[name] = values
    words = {"f4": "float", "u1": "uchar"}
    columns = "".join(f"property {words[kind]} {name}\n" for name, kind in PLY_KINDS)
    vertex = f"element vertex {COUNT}\n{columns}", records.tobytes()
    camera = (
        "element camera 2\nproperty float view_px\nproperty list uchar float k\n",
        struct.pack("<fB2f", 1, 2, 3, 4) * 2,
    )
    parts = [camera, vertex] if first else [vertex, camera]
    head = "".join(["ply\nformat binary_little_endian 1.0\n", *(part[0] for part in parts)])
    body = b"".join(part[1] for part in parts)
    (tmp_path / "a.ply").write_bytes(f"{head}end_header\n".encode() + body)
    assert_holds(skipnet.read_cloud(tmp_path / "a.ply"), P, {"colour": RGB})


def test_two_scans_of_a_ptx_file_each_with_a_transform_of_its_own(tmp_path):
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # as it stands in the file: transposed
    text = ""
    for place, rows in (((0, 0, 0), np.eye(3)), ((10, 20, 1), turn)):
        where = "{} {} {}".format(*place)
        matrix = "".join("{} {} {} 0\n".format(*row) for row in rows)
        text += f"20\n{COUNT // 20}\n{where}\n1 0 0\n0 1 0\n0 0 1\n{matrix}{where} 1\n"
        text += lines(XYZ + " {:.4f}", P, SHINE / 4096)
    (tmp_path / "a.ptx").write_text(text)
    first, second = read_scans(tmp_path / "a.ptx")
    assert_holds(first, P, {"intensity": np.round(SHINE / 4096, 4)})
    assert_holds(second, P @ turn + [10, 20, 1], {})
    assert second.viewpoint_m.tolist() == [10, 20, 1]


def test_records_with_a_field_of_three_colours(tmp_path):
    kinds = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("rgb", "u1", (3,)), ("intensity", "f4")]
    records = np.zeros(COUNT, kinds)
    for axis, values in zip("xyz", P.T, strict=True):
        records[axis] = values
    records["rgb"], records["intensity"] = RGB, SHINE
    np.save(tmp_path / "a.npy", records)
    assert_holds(skipnet.read_cloud(tmp_path / "a.npy"), P, {"colour": RGB, "intensity": SHINE})


def test_scaled_extra_bytes_of_las(tmp_path):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-3), np.floor(MAP.mean(axis=0))
    scaled = {"scales": np.array([0.01]), "offsets": np.array([0.0])}
    header.add_extra_dim(laspy.ExtraBytesParams("height above ground", "i4", **scaled))
    las = laspy.LasData(header)
    las.x, las.y, las.z = MAP.T
    las.red, las.green, las.blue = 256 * RGB.T
    las["height above ground"] = P[:, 2]
    las.write(tmp_path / "a.las")
    cloud = skipnet.read_cloud(tmp_path / "a.las")
    assert_holds(cloud, MAP, {"colour": RGB})
    np.testing.assert_allclose(cloud.columns["height above ground"], P[:, 2], atol=0.006)


def test_open3d_s_tensors_as_files(tmp_path):
    o3d = pytest.importorskip("open3d")
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(P))
    cloud.point.colors = o3d.core.Tensor(RGB.astype(np.uint8))
    cloud.point["intensity"] = o3d.core.Tensor(SHINE.reshape(-1, 1).astype(np.float32))
    for extension in ("ply", "pcd", "npz"):
        o3d.t.io.write_point_cloud(str(tmp_path / f"a.{extension}"), cloud)
        read = skipnet.read_cloud(tmp_path / f"a.{extension}")
        assert_holds(read, P, {"colour": RGB, "intensity": SHINE})
