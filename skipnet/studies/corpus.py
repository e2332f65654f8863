"""Small whole files of every format, written by the libraries that people write them with."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from skipnet.checks import require_package
from skipnet.types import FloatArray

POINTS = 30
_PTX_HEAD = "2\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n3 0 0 1\n"


def corpus(extension: str) -> list[bytes]:
    """The contents of whole files of a format, the same at every call.

    Args:
        extension: as in ``skipnet.clouds.formats.reading.SUPPORTED``.

    Raises:
        ImportError: the library that writes them is missing.
    """
    points = np.random.default_rng(0).uniform(-5, 5, (POINTS, 3))
    with tempfile.TemporaryDirectory() as folder:
        files = _WRITERS[extension](Path(folder), points)
        return [path.read_bytes() for path in files]


def _from_open3d(extension: str) -> Callable[[Path, FloatArray], Iterator[Path]]:
    def write(folder: Path, points: FloatArray) -> Iterator[Path]:
        """As text, as numbers and packed, as far as the format has these."""
        import open3d

        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        for name, as_text, packed in (("a", True, False), ("b", False, False), ("c", False, True)):
            path = folder / f"{name}{extension}"
            cloud.normals = open3d.utility.Vector3dVector(points / 10)
            cloud.colors = open3d.utility.Vector3dVector(np.abs(points) / 5)
            open3d.io.write_point_cloud(path, cloud, write_ascii=as_text, compressed=packed)
            yield path

    return write


def _from_laspy(extension: str) -> Callable[[Path, FloatArray], Iterator[Path]]:
    def write(folder: Path, points: FloatArray) -> Iterator[Path]:
        """The old point formats and the new ones, whose chunks have layers."""
        laspy = require_package("laspy", "'skipnet[formats]'")
        for kind, version in ((0, "1.2"), (3, "1.3"), (6, "1.4"), (7, "1.4")):
            path = folder / f"{kind}{extension}"
            cloud = laspy.create(point_format=kind, file_version=version)
            cloud.header.scales = [1e-4] * 3
            cloud.x, cloud.y, cloud.z = points.T
            cloud.intensity = np.arange(POINTS)
            cloud.write(str(path))
            yield path

    return write


def _from_trimesh(kind: str) -> Callable[[Path, FloatArray], Iterator[Path]]:
    def write(folder: Path, points: FloatArray) -> Iterator[Path]:
        """A box and a scene of one triangle."""
        trimesh = require_package("trimesh", "'skipnet[formats]'")
        for number, mesh in enumerate(
            (trimesh.creation.box(), trimesh.Trimesh(points[:3], [[0, 1, 2]]))
        ):
            path = folder / f"{number}.{kind}"
            mesh.export(str(path))
            yield path

    return write


def _e57(folder: Path, points: FloatArray) -> Iterator[Path]:
    pye57 = require_package("pye57", "'skipnet[formats]'")
    path = folder / "a.e57"
    file = pye57.E57(str(path), mode="w")
    for shift in (0.0, 1.0):
        columns = {f"cartesian{axis}": points[:, k] + shift for k, axis in enumerate("XYZ")}
        columns["intensity"] = np.abs(points[:, 0])
        file.write_scan_raw(columns, translation=np.full(3, shift))
    file.close()
    yield path


def _text(folder: Path, points: FloatArray) -> Iterator[Path]:
    for name, mark, head in (("a", " ", ""), ("b", ",", "x,y,z"), ("c", ";", "X;Y;Z")):
        path = folder / name
        np.savetxt(path, points, "%.4f", mark, header=head, comments="")
        yield path


def _pts(folder: Path, points: FloatArray) -> Iterator[Path]:
    for name, more in (("a", ""), ("b", " 7 10 20 30")):
        path = folder / name
        rows = "\n".join(f"{x:.3f} {y:.3f} {z:.3f}{more}" for x, y, z in points)
        path.write_text(f"{len(points)}\n{rows}\n")
        yield path


def _ptx(folder: Path, points: FloatArray) -> Iterator[Path]:
    path = folder / "a.ptx"
    path.write_text(2 * (_PTX_HEAD + "1 0 0 0.5\n0 1 0 0.5\n"))
    yield path


def _numpy(folder: Path, points: FloatArray) -> Iterator[Path]:
    for number, array in enumerate((points, points.astype(np.float32), np.asfortranarray(points))):
        path = folder / f"{number}.npy"
        np.save(path, array)
        yield path


def _archive(folder: Path, points: FloatArray) -> Iterator[Path]:
    np.savez(folder / "a.npz", points=points, colors=np.abs(points).astype(np.uint8))
    np.savez_compressed(folder / "b.npz", x=points[:, 0], y=points[:, 1], z=points[:, 2])
    yield from (folder / "a.npz", folder / "b.npz")


def _records(folder: Path, points: FloatArray) -> Iterator[Path]:
    path = folder / "a.bin"
    np.hstack([points, points[:, :1]]).astype("<f4").tofile(path)
    yield path


def _depth(folder: Path, points: FloatArray) -> Iterator[Path]:
    from PIL import Image

    path = folder / "a.png"
    Image.fromarray(np.arange(30, dtype=np.uint16).reshape(5, 6) * 100).save(path)
    yield path


_WRITERS: dict[str, Callable[[Path, FloatArray], Iterator[Path]]] = {
    ".ply": _from_open3d(".ply"),
    ".pcd": _from_open3d(".pcd"),
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc"), _text),
    ".pts": _pts,
    ".ptx": _ptx,
    ".npy": _numpy,
    ".npz": _archive,
    ".las": _from_laspy(".las"),
    ".laz": _from_laspy(".laz"),
    ".e57": _e57,
    ".bin": _records,
    ".png": _depth,
    **{f".{kind}": _from_trimesh(kind) for kind in ("obj", "stl", "glb", "off")},
}
