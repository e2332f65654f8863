"""docs/formats.md's table: files of other libraries are read, written, and read by these again."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.geometry import make_transform

N = 400
UTM_M = np.array([500_000.0, 5_400_000.0, 100.0])
TURN = make_transform(np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]), np.array([1.0, 2, 3]))
_rng = np.random.default_rng(5)
P = np.round(_rng.uniform(-9, 9, (N, 3)), 4)
RGB = _rng.integers(0, 256, (N, 3)).astype(np.uint8)
INTENSITY = _rng.integers(0, 60_000, N)
LABEL = _rng.integers(0, 9, N)
NORMALS = P / np.linalg.norm(P, axis=1, keepdims=True)


def laspy_writes(path):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-4), UTM_M
    las = laspy.LasData(header)
    las.x, las.y, las.z = (P + UTM_M).T
    las.red, las.green, las.blue = (RGB.astype(np.uint16) * 257).T
    las.intensity, las.classification = INTENSITY, LABEL
    las.write(path)


def laspy_reads(path):
    import laspy

    las = laspy.read(path)
    colours = np.stack([las.red, las.green, las.blue], axis=1) // 257
    return {
        "points": las.xyz, "colour": colours, "intensity": las.intensity,
        "label": las.classification,
    }  # fmt: skip


def pye57_writes(path):
    pye57 = pytest.importorskip("pye57")
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), P.T.copy(), strict=True))
    columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), RGB.T.copy(), strict=True))
    columns["intensity"] = INTENSITY.astype(np.float64)
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


def open3d_writes(path):
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(P))
    cloud.colors = o3d.utility.Vector3dVector(RGB / 255)
    cloud.normals = o3d.utility.Vector3dVector(NORMALS)
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


def numpy_writes(path):
    if path.suffix == ".npz":
        np.savez(path, points=P + UTM_M, colors=RGB, normals=NORMALS, intensity=INTENSITY)
    else:
        table = np.column_stack([P + UTM_M, RGB, INTENSITY])
        mark = "," if path.suffix == ".csv" else " "
        names = mark.join(["x", "y", "z", "red", "green", "blue", "intensity"])
        np.savetxt(path, table, ["%.4f"] * 3 + ["%d"] * 4, mark, header=names, comments="")


def numpy_reads(path):
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {"points": arrays["points"], "colour": arrays["colors"],
                    "normals": arrays["normals"], "intensity": arrays["intensity"]}  # fmt: skip
    table = np.loadtxt(path, delimiter="," if path.suffix == ".csv" else None, skiprows=1)
    return {"points": table[:, :3], "colour": table[:, 3:6], "intensity": table[:, 6]}


TRIPS = {
    "las": (laspy_writes, laspy_reads, UTM_M, 1e-4),
    "laz": (laspy_writes, laspy_reads, UTM_M, 1e-4),
    "e57": (pye57_writes, pye57_reads, UTM_M, 1e-6),  # pye57 writes single precision
    "ply": (open3d_writes, open3d_reads, np.zeros(3), 1e-6),
    "pcd": (open3d_writes, open3d_reads, np.zeros(3), 1e-6),
    "npz": (numpy_writes, numpy_reads, UTM_M, 1e-8),
    "csv": (numpy_writes, numpy_reads, UTM_M, 1e-5),
    "xyz": (numpy_writes, numpy_reads, UTM_M, 1e-5),
}
"""Format: who writes and reads it, where its points lie, and how exactly they come back (m)."""
EXPECTED = {"colour": RGB, "intensity": INTENSITY, "label": LABEL}


@pytest.mark.parametrize("extension", TRIPS)
def test_what_another_library_wrote_it_reads_again_moved(tmp_path, extension):
    write, read, place_m, exact_m = TRIPS[extension]
    write(tmp_path / f"theirs.{extension}")
    cloud = skipnet.read_cloud(tmp_path / f"theirs.{extension}")
    skipnet.write_cloud(tmp_path / f"ours.{extension}", cloud.moved(TURN))
    found = read(tmp_path / f"ours.{extension}")
    expected_m = (P + place_m) @ TURN[:3, :3].T + TURN[:3, 3]
    np.testing.assert_allclose(found["points"], expected_m, atol=exact_m, rtol=0)
    for name in set(EXPECTED) & set(found):
        np.testing.assert_array_equal(found[name], EXPECTED[name])
    if "normals" in found:
        np.testing.assert_allclose(found["normals"], NORMALS @ TURN[:3, :3].T, atol=1e-6)
