"""docs/formats.md's table: two scans that another library wrote are read, registered, written, and
read by that library again."""

from __future__ import annotations

import json

import numpy as np
import pytest

import skipnet
from skipnet.geometry import make_transform, transform_points
from skipnet.simulation.scanning.pairs import simulate_pair

UTM_M = np.array([500_000.0, 5_400_000.0, 100.0])


class Scan:
    """What is written: rounded to what the coarsest of the formats keeps."""

    def __init__(self, points_m, seed):
        rng = np.random.default_rng(seed)
        self.points = np.round(np.asarray(points_m, np.float64), 4)
        count = len(points_m)
        self.colour = rng.integers(0, 256, (count, 3)).astype(np.uint8)
        self.intensity = rng.integers(0, 60_000, count)
        self.label = rng.integers(0, 9, count)
        self.time = 1e9 + np.round(1e5 * rng.random(count), 5)
        self.normals = rng.normal(size=(count, 3))
        self.normals /= np.linalg.norm(self.normals, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def scans():
    pair = simulate_pair("paper_room", 7, points=8_000).pair
    return Scan(pair.source_m, 1), Scan(pair.target_m, 2), pair.T_target_source


def laspy_writes(path, scan):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-4), UTM_M
    las = laspy.LasData(header)
    las.x, las.y, las.z = (scan.points + UTM_M).T
    las.red, las.green, las.blue = (scan.colour.astype(np.uint16) * 257).T
    las.intensity, las.classification, las.gps_time = scan.intensity, scan.label, scan.time
    las.write(path)


def laspy_reads(path):
    import laspy

    las = laspy.read(path)
    colours = np.stack([las.red, las.green, las.blue], axis=1) // 257
    return {
        "points": las.xyz, "colour": colours, "intensity": las.intensity,
        "label": las.classification, "time": las.gps_time,
    }  # fmt: skip


def pye57_writes(path, scan):
    pye57 = pytest.importorskip("pye57")
    columns = dict(
        zip(("cartesianX", "cartesianY", "cartesianZ"), scan.points.T.copy(), strict=True)
    )
    columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), scan.colour.T.copy(), strict=True))
    columns["intensity"] = scan.intensity.astype(np.float64)
    file = pye57.E57(str(path), mode="w")
    file.write_scan_raw(columns, translation=UTM_M)
    file.close()


def pye57_reads(path):
    import pye57

    scan = pye57.E57(str(path)).read_scan(
        0, colors=True, intensity=True, ignore_missing_fields=True
    )
    names = ("cartesianX", "cartesianY", "cartesianZ")
    colours = [scan[name] for name in ("colorRed", "colorGreen", "colorBlue")]
    return {
        "points": np.stack([scan[name] for name in names], axis=1),
        "colour": np.stack(colours, axis=1), "intensity": scan["intensity"],
    }  # fmt: skip


def open3d_writes(path, scan):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points))
    cloud.colors = o3d.utility.Vector3dVector(scan.colour / 255)
    cloud.normals = o3d.utility.Vector3dVector(scan.normals)
    o3d.io.write_point_cloud(str(path), cloud)


def open3d_reads(path):
    """Its tensors, which keep the doubles that it has not for itself."""
    import open3d as o3d

    cloud = o3d.t.io.read_point_cloud(str(path)).point
    colours = cloud.colors.numpy()
    scale = 255 if colours.dtype.kind == "f" else 1
    return {
        "points": cloud.positions.numpy(), "colour": np.rint(scale * colours),
        "normals": cloud.normals.numpy(),
    }  # fmt: skip


def trimesh_writes(path, scan):
    """A cloud of coloured points: PLY or GLB."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.PointCloud(scan.points, colors=scan.colour).export(path)


def trimesh_reads(path):
    import trimesh

    cloud = trimesh.load(path)
    return {"points": cloud.vertices, "colour": cloud.visual.vertex_colors[:, :3]}


def numpy_writes(path, scan):
    """Archives, tables with names, KITTI's raw numbers, and PTS and PTX by their rules."""
    places = scan.points + UTM_M
    if path.suffix == ".npz":
        np.savez(path, points=places, colors=scan.colour, normals=scan.normals,
                 intensity=scan.intensity)  # fmt: skip
    elif path.suffix == ".bin":
        np.column_stack([scan.points, scan.intensity]).astype("<f4").tofile(path)
    elif path.suffix in (".csv", ".xyz"):
        table = np.column_stack([places, scan.colour, scan.intensity, scan.time])
        mark = "," if path.suffix == ".csv" else " "
        names = mark.join(["x", "y", "z", "red", "green", "blue", "intensity", "time"])
        form = ["%.4f"] * 3 + ["%d"] * 4 + ["%.5f"]
        np.savetxt(path, table, form, mark, header=names, comments="")
    else:
        head = f"{len(scan.points)}"
        if path.suffix == ".ptx":
            turn = "\n".join(f"{a} {b} {c}" for a, b, c in np.eye(3))
            pose = "1 0 0 0\n0 1 0 0\n0 0 1 0\n{} {} {} 1".format(*UTM_M)
            places = scan.points
            head = "\n".join([head, "1", "{} {} {}".format(*UTM_M), turn, pose])
        table = np.column_stack([places, scan.intensity, scan.colour])
        np.savetxt(path, table, ["%.4f"] * 3 + ["%d"] * 4, header=head, comments="")


def numpy_reads(path):
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {"points": arrays["points"], "colour": arrays["colors"],
                    "normals": arrays["normals"], "intensity": arrays["intensity"]}  # fmt: skip
    table = np.loadtxt(path, delimiter="," if path.suffix == ".csv" else None, skiprows=1)
    found = {"points": table[:, :3]}
    if table.shape[1] > 4:
        found |= {"colour": table[:, 3:6]}
    found["intensity"] = table[:, 6 if table.shape[1] > 4 else 3]
    return found | ({"time": table[:, 7]} if table.shape[1] > 7 else {})


LAS, E57 = (laspy_writes, laspy_reads), (pye57_writes, pye57_reads)
O3D, MESH, TEXT = (
    (open3d_writes, open3d_reads), (trimesh_writes, trimesh_reads), (numpy_writes, numpy_reads)
)  # fmt: skip
LOCAL_M = np.zeros(3)
TRIPS = {
    "las": (*LAS, "las", UTM_M, 1e-4, {"colour", "intensity", "label", "time"}),
    "laz": (*LAS, "laz", UTM_M, 1e-4, {"colour", "intensity", "label", "time"}),
    # pye57 writes single precision
    "e57": (*E57, "e57", UTM_M, 1e-6, {"colour", "intensity"}),
    "ply": (*O3D, "ply", LOCAL_M, 1e-6, {"colour", "normals"}),
    "pcd": (*O3D, "pcd", LOCAL_M, 1e-6, {"colour", "normals"}),
    "ply of trimesh": (*MESH, "ply", LOCAL_M, 1e-6, {"colour"}),
    "glb": (*MESH, "ply", LOCAL_M, 2e-6, {"colour"}),
    "npz": (*TEXT, "npz", UTM_M, 1e-8, {"colour", "intensity", "normals"}),
    "csv": (*TEXT, "csv", UTM_M, 1e-5, {"colour", "intensity", "time"}),
    "xyz": (*TEXT, "xyz", UTM_M, 1e-5, {"colour", "intensity", "time"}),
    "pts": (*TEXT, "xyz", UTM_M, 1e-5, {"colour", "intensity"}),
    "ptx": (*TEXT, "xyz", UTM_M, 1e-5, {"colour", "intensity"}),
    "bin": (*TEXT, "xyz", LOCAL_M, 1e-5, {"intensity"}),
}
"""Format: who writes and reads it, what is written, where its points lie, how exactly they come
back (m), and what else does."""


def in_frame(T, place_m):
    """A motion between scans that both lie at a place."""
    there = make_transform(np.eye(3), place_m)
    return there @ T @ make_transform(np.eye(3), -place_m)


@pytest.mark.parametrize("kind", TRIPS)
def test_what_another_library_wrote_it_reads_again_registered(tmp_path, scans, kind):
    write, read, written, place_m, exact_m, survives = TRIPS[kind]
    named = write is numpy_writes and place_m is UTM_M and kind != "ptx"
    source, target, T_true = scans
    extension = kind.partition(" ")[0]
    write(tmp_path / f"a.{extension}", source)
    write(tmp_path / f"b.{extension}", target)
    # Where the sensor stood, tables and arrays cannot say; without it so few points are refused.
    stood = {f"{name}_viewpoint": place_m for name in ("source", "target")}
    result = skipnet.register(
        tmp_path / f"a.{extension}", tmp_path / f"b.{extension}", **(stood if named else {})
    )
    T_expected = in_frame(T_true, place_m)
    assert result.status == "registered"
    aligned = result.transform(skipnet.read_cloud(tmp_path / f"a.{extension}"))
    skipnet.write_cloud(tmp_path / f"ours.{written}", aligned)
    found = read(tmp_path / f"ours.{written}")
    expected_m = transform_points(result.T_target_source, source.points + place_m)
    np.testing.assert_allclose(found.pop("points"), expected_m, atol=exact_m, rtol=0)
    away_m = expected_m - transform_points(T_expected, source.points + place_m)
    assert np.linalg.norm(away_m, axis=1).max() < 0.05
    assert set(found) == survives
    for name in survives - {"normals"}:
        np.testing.assert_allclose(found[name], getattr(source, name), rtol=0, atol=1e-5)
    if "normals" in survives:
        turned = source.normals @ result.T_target_source[:3, :3].T
        np.testing.assert_allclose(found["normals"], turned, atol=1e-6)


ROOM = [
    ((6, 5, 0.2), (0, 0, -0.1)), ((0.2, 5, 2.5), (-3, 0, 1.25)),
    ((6, 0.2, 2.5), (0, 2.5, 1.25)), ((0.2, 2.2, 2.5), (3, 1.4, 1.25)),
    ((1.2, 0.7, 0.8), (-1.9, 1.2, 0.4)), ((0.5, 0.6, 1.6), (1.7, 1.9, 0.8)),
    ((0.9, 0.4, 0.5), (0.8, -1.1, 0.25)), ((0.4, 1.3, 1.1), (-2.4, -1.3, 0.55)),
    ((0.3, 0.3, 2.2), (0.3, 0.9, 1.1)),
]  # fmt: skip
"""Sizes and places (m) of the boxes that are walls and furniture, nowhere alike."""


def a_room():
    """The same as a mesh."""
    import trimesh

    placed = [
        trimesh.creation.box(size, make_transform(np.eye(3), np.array(place, float)))
        for size, place in ROOM
    ]
    return trimesh.util.concatenate(placed)


@pytest.mark.parametrize("extension", ["stl", "obj", "glb"])
def test_meshes_of_trimesh_are_brought_together(tmp_path, extension):
    trimesh = pytest.importorskip("trimesh")
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    T_target_source = make_transform(turn, np.array([1.0, 2, 0.3]))
    mesh = a_room()
    mesh.export(tmp_path / f"b.{extension}")
    mesh.apply_transform(np.linalg.inv(T_target_source))
    corners_m = np.array(mesh.vertices)
    mesh.export(tmp_path / f"a.{extension}")
    result = skipnet.register(tmp_path / f"a.{extension}", tmp_path / f"b.{extension}")
    assert result.status == "registered"
    expected_m = transform_points(T_target_source, corners_m)
    found_m = transform_points(result.T_target_source, corners_m)
    assert np.linalg.norm(found_m - expected_m, axis=1).max() < 0.01
    skipnet.write_cloud(tmp_path / "ours.ply", result.transform(tmp_path / f"a.{extension}"))
    read_m = trimesh.load(tmp_path / "ours.ply").vertices
    own_m = skipnet.read_points(tmp_path / f"a.{extension}")
    moved_m = transform_points(result.T_target_source, own_m)
    np.testing.assert_allclose(read_m, moved_m, atol=1e-6)


WIDTH, HEIGHT, FOCAL = 240, 180, 130.0


def look(T_room_camera):
    """Depths (m) of the room as a camera sees it: the nearest box that each pixel's ray enters."""
    row, column = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1)
    rays = np.stack(
        [(column - WIDTH / 2) / FOCAL, (row - HEIGHT / 2) / FOCAL, np.ones(row.size)], 1
    )
    rays, eye_m = rays @ T_room_camera[:3, :3].T, T_room_camera[:3, 3]
    depth_m = np.full(len(rays), np.inf)
    for size, place in np.array(ROOM, float):
        ends = ((place + np.outer([-0.5, 0.5], size) - eye_m)[:, None] / rays).astype(float)
        enters, leaves = np.min(ends, 0).max(1), np.max(ends, 0).min(1)
        depth_m = np.where((enters < leaves) & (enters > 0), np.minimum(depth_m, enters), depth_m)
    return np.where(depth_m < 60, depth_m, 0).reshape(HEIGHT, WIDTH)


def camera_at(eye_m, yaw_deg):
    """x to the right, y down, z ahead; a little down, as they are held."""
    yaw, down = np.deg2rad(yaw_deg), np.deg2rad(20)
    ahead = np.array([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0])
    return make_transform(np.stack([right, np.cross(ahead, right), ahead], 1), np.array(eye_m))


def test_depth_images_of_pillow_are_brought_together(tmp_path):
    from PIL import Image

    poses = camera_at([2.2, -2.0, 1.6], 135), camera_at([1.6, -2.2, 1.5], 122)
    for name, T_room_camera in zip("ab", poses, strict=True):
        depth_mm = np.rint(1000 * look(T_room_camera)).astype(np.uint16)
        Image.fromarray(depth_mm).save(tmp_path / f"{name}.png")
    camera = {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "depth_scale": 1000}
    (tmp_path / "intrinsics.json").write_text(json.dumps(camera))
    result = skipnet.register(tmp_path / "a.png", tmp_path / "b.png")
    assert result.status == "registered"
    cloud = skipnet.read_cloud(tmp_path / "a.png")
    T_true = np.linalg.inv(poses[1]) @ poses[0]
    found_m, expected_m = result.transform(cloud).points_m, transform_points(T_true, cloud.points_m)
    assert np.linalg.norm(found_m - expected_m, axis=1).max() < 0.02
    skipnet.write_cloud(tmp_path / "ours.ply", result.transform(cloud))
    np.testing.assert_allclose(open3d_points(tmp_path / "ours.ply"), found_m, atol=1e-6)


def open3d_points(path):
    import open3d as o3d

    return o3d.t.io.read_point_cloud(str(path)).point.positions.numpy()


@pytest.mark.parametrize("extension", ["las", "laz"])
def test_pieces_of_a_cloud_are_written_as_the_whole_is(tmp_path, extension):
    rng = np.random.default_rng(4)
    whole = skipnet.Cloud(
        rng.uniform(0, 50, (3000, 3)) + [4e5, 5e6, 0],
        colour=rng.integers(0, 65536, (3000, 3)).astype(np.uint16),
        intensity=rng.integers(0, 4000, 3000).astype(np.uint16),
        columns={"classification": rng.integers(0, 20, 3000).astype(np.uint8)},
        offset_m=np.array([4e5, 5e6, 0]),
    )
    path, again = tmp_path / f"a.{extension}", tmp_path / f"b.{extension}"
    skipnet.write_cloud(path, whole)
    rows = np.array_split(np.arange(3000), 7)
    skipnet.write_cloud(again, iter([whole[some] for some in rows]))
    one, other = skipnet.read_cloud(path), skipnet.read_cloud(again)
    np.testing.assert_array_equal(one.points_m, other.points_m)
    np.testing.assert_array_equal(one.colour, other.colour)
    np.testing.assert_array_equal(one.intensity, other.intensity)
    np.testing.assert_array_equal(one.columns["classification"], other.columns["classification"])
    np.testing.assert_allclose(one.points_m, whole.points_m, atol=6e-5)
