"""Binary files as other programs lay them out: sixty points of each kind."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest

import skipnet

N = 60
_rng = np.random.default_rng(3)
P = np.round(_rng.uniform(-5, 5, (N, 3)), 4)
RGB = _rng.integers(0, 256, (N, 3))
SHARE = RGB[:, 0] / 255
DOUBLES = "property double x\nproperty double y\nproperty double z\n"


def records(order, *columns):
    """Packed records of (kind, values)."""
    kinds = [(f"f{number}", order + kind) for number, (kind, _) in enumerate(columns)]
    table = np.empty(N, kinds)
    for number, (_, values) in enumerate(columns):
        table[f"f{number}"] = values
    return table.tobytes()


def places(order="<"):
    return [("f8", axis) for axis in P.T]


def ply(properties, body, name="vertex", order="binary_little_endian", comment="none"):
    head = f"ply\nformat {order} 1.0\ncomment {comment}\nobj_info none\n"
    return f"{head}element {name} {N}\n{DOUBLES}{properties}end_header\n".encode() + body


PLYS = {
    "64 bits": ply("property int64 t\nproperty uint64 u\n",
                   records("<", *places(), ("i8", 7), ("u8", 8))),
    "points": ply("", records("<", *places()), "point"),
    "big-endian of all kinds": ply(
        "property short a\nproperty ushort b\nproperty char c\n",
        records(">", *places(), ("i2", -3), ("u2", 9), ("i1", -1)), order="binary_big_endian",
    ),
    "a name twice": ply("property float q\nproperty float q\n",
                        records("<", *places(), ("f4", 1), ("f4", 2))),
    "a long comment": ply("", records("<", *places()), comment="a" * 9000),
    "Windows": ply("", b"").replace(b"\n", b"\r\n") + records("<", *places()),
}  # fmt: skip


@pytest.mark.parametrize("kind", PLYS)
def test_a_kind_of_ply(tmp_path, kind):
    (tmp_path / "a.ply").write_bytes(PLYS[kind])
    np.testing.assert_array_equal(skipnet.read_points(tmp_path / "a.ply"), P)


def test_a_ply_that_says_its_unit(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("", records("<", *places()), comment="units: mm"))
    cloud = skipnet.read_cloud(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.points_m, P / 1000)
    assert cloud.unit == "mm"


def pcd(fields, sizes, kinds, counts, body):
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\n"
        f"WIDTH {N}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {N}\nDATA binary\n"
    ).encode() + body


def test_pcd_with_padding_histograms_and_empty_fields(tmp_path):
    table = np.zeros(N, [("p", "<f4", 3), ("_", "u1", 4), ("i", "<f4"), ("h", "<f4", 33),
                         ("ring", "<u2"), ("__", "u1", 10)])  # fmt: skip
    table["p"], table["i"], table["ring"] = P, SHARE, np.arange(N)
    (tmp_path / "a.pcd").write_bytes(
        pcd("x y z _ intensity fpfh empty ring _", "4 4 4 1 4 4 4 2 1", "F F F U F F F U U",
            "1 1 1 4 1 33 0 1 10", table.tobytes())
    )  # fmt: skip
    cloud = skipnet.read_cloud(tmp_path / "a.pcd")
    np.testing.assert_allclose(cloud.points_m, P, atol=1e-6)
    np.testing.assert_allclose(cloud.intensity, SHARE, atol=1e-6)
    assert list(cloud.columns) == ["ring"] and cloud.columns["ring"].tolist() == list(range(N))


@pytest.mark.parametrize("kind", range(11))
@pytest.mark.parametrize("extension", ["las", "laz"])
def test_every_point_format_of_las_with_extra_bytes(tmp_path, kind, extension):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(
        point_format=kind, version="1.4" if kind > 5 else "1.3" if kind > 3 else "1.2"
    )
    header.scales = np.full(3, 1e-4)
    header.add_extra_dim(laspy.ExtraBytesParams("reflectivity", "f4"))
    header.add_extra_dim(laspy.ExtraBytesParams("vector", "3f4"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = P.T
    las.reflectivity, las.vector = SHARE, P
    has_colours = "red" in list(las.point_format.dimension_names)
    if has_colours:
        las.red, las.green, las.blue = (257 * RGB).T.astype(np.uint16)
    las.write(tmp_path / f"a.{extension}")
    cloud = skipnet.read_cloud(tmp_path / f"a.{extension}")
    np.testing.assert_allclose(cloud.points_m, P, atol=1e-6)
    np.testing.assert_allclose(cloud.intensity, SHARE, atol=1e-6)
    np.testing.assert_allclose(cloud.columns["vector 2"], P[:, 2], atol=1e-6)
    assert (cloud.colour is not None) == has_colours
    if has_colours:
        np.testing.assert_array_equal(cloud.colour, RGB)
    for other in ("ply", "pcd", "csv", "npz", "laz"):
        skipnet.write_cloud(tmp_path / f"b.{other}", cloud)
        assert len(skipnet.read_cloud(tmp_path / f"b.{other}").columns) >= 3


@pytest.mark.parametrize(
    ("columns", "kind"),
    [([P, SHARE], "f4"), ([P, SHARE, np.arange(N) % 32], "f4"), ([P], "f4"), ([P], "f8")],
)
def test_raw_numbers(tmp_path, columns, kind):
    np.column_stack(columns).astype(f"<{kind}").tofile(tmp_path / "a.bin")
    cloud = skipnet.read_cloud(tmp_path / "a.bin")
    np.testing.assert_allclose(cloud.points_m, P, atol=1e-6)
    assert bool(cloud.notes) == (len(columns) != 2)
    if len(columns) > 1:
        np.testing.assert_allclose(cloud.intensity, SHARE, atol=1e-6)


def test_raw_numbers_with_beams_that_met_nothing(tmp_path):
    gaps = P.copy()
    gaps[5] = np.nan
    np.column_stack([gaps, SHARE]).astype("<f4").tofile(tmp_path / "a.bin")
    assert len(skipnet.read_points(tmp_path / "a.bin")) == N - 1


@pytest.mark.parametrize(
    "key", ["points", "xyz", "pts", "pc", "point_cloud", "arr_0", "XYZ", "Points", "coord", "mine"]
)
def test_keys_of_archives(tmp_path, key):
    np.savez(tmp_path / "a.npz", **{key: P, "pose": np.eye(4), "colors": RGB.astype(np.uint8)})
    cloud = skipnet.read_cloud(tmp_path / "a.npz")
    np.testing.assert_array_equal(cloud.points_m, P)
    np.testing.assert_array_equal(cloud.colour, RGB)


FRAMES = [("xyz", "f8", 3), ("rgb", "u1", 3)]
ARRAYS = {
    "columns": P.T.copy(),
    "pixels": P.reshape(10, 6, 3),
    "pixels with intensity": np.column_stack([P, SHARE]).reshape(10, 6, 4),
    "a batch of one": P[None],
    "big-endian": P.astype(">f8"),
    "records of vectors": np.array([(a, b) for a, b in zip(P, RGB, strict=True)], FRAMES),
}


@pytest.mark.parametrize("kind", ARRAYS)
def test_shapes_of_arrays(tmp_path, kind):
    np.save(tmp_path / "a.npy", ARRAYS[kind])
    np.testing.assert_array_equal(skipnet.read_points(tmp_path / "a.npy"), P)


def test_images_of_coordinates(tmp_path):
    x, y, z = (axis.reshape(10, 6) for axis in P.T)
    np.savez(tmp_path / "a.npz", X=x, Y=y, Z=z)
    np.testing.assert_array_equal(skipnet.read_points(tmp_path / "a.npz"), P)


BOX = np.array([[x, y, z] for z in (0, 2) for x, y in ((0, 0), (4, 0), (4, 3), (0, 3))])
SIDES = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
VERTICES = "".join(f"v {x} {y} {z}\n" for x, y, z in BOX)
OBJS = {
    "polygons": VERTICES + "".join(f"f {' '.join(str(k + 1) for k in side)}\n" for side in SIDES),
    "negative": VERTICES + "".join(f"f {' '.join(str(k - 8) for k in side)}\n" for side in SIDES),
    "groups": "mtllib a.mtl\no box\n" + VERTICES + "vt 0 0\nvn 0 0 1\n" + "".join(
        f"g side{number}\nusemtl stone\ns off\nf {' '.join(f'{k + 1}/1/1' for k in side)}\n"
        for number, side in enumerate(SIDES)
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", OBJS)
def test_a_kind_of_obj(tmp_path, kind):
    pytest.importorskip("trimesh")
    (tmp_path / "a.obj").write_text(OBJS[kind])
    points_m = skipnet.read_points(tmp_path / "a.obj")
    np.testing.assert_allclose(points_m.min(axis=0), [0, 0, 0], atol=0.01)
    np.testing.assert_allclose(points_m.max(axis=0), [4, 3, 2], atol=0.01)


def test_stl_of_both_kinds_and_a_glb_whose_nodes_move(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.Trimesh(
        BOX, [side[:3] for side in SIDES] + [side[2:] + side[:1] for side in SIDES]
    )
    (tmp_path / "a.stl").write_text(box.export(file_type="stl_ascii"))
    named = b"solid by a scanner".ljust(80) + box.export(file_type="stl")[80:]
    (tmp_path / "b.stl").write_bytes(named)
    scene = trimesh.Scene()
    T = np.eye(4)
    T[0, 3] = 10
    scene.add_geometry(box, node_name="here")
    scene.add_geometry(box, node_name="there", transform=T)
    (tmp_path / "c.glb").write_bytes(scene.export(file_type="glb"))
    for name, far_x in (("a.stl", 4), ("b.stl", 4), ("c.glb", 14)):
        points_m = skipnet.read_points(tmp_path / name)
        np.testing.assert_allclose(points_m.max(axis=0), [far_x, 3, 2], atol=0.01)


MATRIX = [[50, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]
FLAT = np.ravel(MATRIX).tolist()
CAMERAS = {
    "intrinsics.json": json.dumps({"fx": 50, "fy": 60, "cx": 31.5, "cy": 23.5}),
    "a.json": json.dumps({"K": FLAT, "depth_scale": 0.001}),
    "camera.json": json.dumps({"camera": {"fx": 50, "fy": 60, "ppx": 31.5, "ppy": 23.5}}),
    "camera_info.json": json.dumps({"camera_matrix": {"rows": 3, "data": FLAT}}),
    "camera_intrinsics.json": json.dumps({"intrinsic_matrix": MATRIX}),
    "intrinsic.txt": "50 0 31.5 0\n0 60 23.5 0\n0 0 1 0\n0 0 0 1\n",
    "intrinsics.txt": "50 60 31.5 23.5\n",
    "camera.yaml": "fx: 50\nfy: 60\ncx: 31.5\ncy: 23.5\n",
    "camera-intrinsics.txt": "50,0,31.5\n0,60,23.5\n0,0,1\n",
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_kind_of_camera(tmp_path, name):
    from PIL import Image

    depth = np.full((48, 64), 2000, np.uint16)
    picture = io.BytesIO()
    Image.fromarray(depth).save(picture, "png")
    (tmp_path / "a.png").write_bytes(picture.getvalue())
    (tmp_path / name).write_text(CAMERAS[name])
    rows, columns = np.nonzero(depth)
    expected = np.column_stack([(columns - 31.5) / 25, (rows - 23.5) / 30, np.full(len(rows), 2)])
    np.testing.assert_allclose(skipnet.read_points(tmp_path / "a.png"), expected, atol=1e-9)


def spherical():
    range_m = np.linalg.norm(P, axis=1)
    return {
        "sphericalRange": range_m,
        "sphericalAzimuth": np.arctan2(P[:, 1], P[:, 0]),
        "sphericalElevation": np.arcsin(P[:, 2] / range_m),
        "sphericalInvalidState": np.where(np.arange(N) % 5, 0, 2),
        "rowIndex": np.arange(N) // 8,
        "columnIndex": np.arange(N) % 8,
        "timeStamp": 0.1 * np.arange(N),
    }


def test_e57_of_angles_with_invalid_beams_turned_and_far_away(tmp_path):
    pytest.importorskip("pye57")
    from skipnet.clouds.formats.e57_writing import add_scan, open_e57

    file = open_e57(tmp_path / "a.e57", crs='PROJCS["a"]')
    half = np.pi / 8
    place_m = np.array([500000.123, 5400000.456, 300.789])
    add_scan(file, spherical(), "east", place_m, (np.cos(half), 0, 0, np.sin(half)))
    file.close()
    cloud = skipnet.read_cloud(tmp_path / "a.e57")
    cosine, sine = np.cos(2 * half), np.sin(2 * half)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    met = P[np.arange(N) % 5 > 0]
    np.testing.assert_allclose(cloud.points_m, met @ turn.T + place_m, atol=1e-8)
    np.testing.assert_array_equal(cloud.viewpoint_m, place_m)
    assert cloud.crs == 'PROJCS["a"]' and set(cloud.columns) >= {"rowIndex", "timeStamp"}


def test_e57_keeps_micrometres_of_a_map_without_a_viewpoint(tmp_path):
    pye57 = pytest.importorskip("pye57")
    far = P + [500000, 5400000, 300]
    normals = P / np.linalg.norm(P, axis=1, keepdims=True)
    cloud = skipnet.Cloud(far, RGB.astype(np.uint8), SHARE, normals, crs="EPSG:25832")
    skipnet.write_cloud(tmp_path / "a.e57", cloud)
    read = skipnet.read_cloud(tmp_path / "a.e57")
    np.testing.assert_allclose(read.points_m, far, atol=1e-9, rtol=0)
    np.testing.assert_allclose(read.normals, normals)
    assert read.viewpoint_m is None and read.crs == "EPSG:25832"
    theirs = pye57.E57(str(tmp_path / "a.e57")).read_scan_raw(0, ignore_unsupported_fields=True)
    np.testing.assert_allclose(theirs["cartesianY"], far[:, 1], atol=1e-9, rtol=0)
    np.testing.assert_array_equal(theirs["colorRed"], RGB[:, 0])
