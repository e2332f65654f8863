"""Data sets of scanner stations with poses: ASL's csv sets, WHU-TLS, and scans beside matrices."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from skipnet.benchmark.datasets.layout import Layout
from skipnet.benchmark.datasets.pairset import Listed
from skipnet.benchmark.options import ProtocolKind
from skipnet.clouds.formats.reading import SUPPORTED
from skipnet.geometry import invert
from skipnet.types import FloatArray

ASL_POSES = "pose_scanner_leica.csv"


def list_asl(folder: Path) -> list[Listed]:
    """ASL's laser sets (Pomerleau et al., IJRR 2012): each scan with the one before it.

    ``SCENE/csv_local/Hokuyo_N.csv`` with ``SCENE/csv_global/pose_scanner_leica.csv``; newer
    archives call the folders local_frame and global_frame. The poses map a scan's frame to the
    world's.
    """
    listed = []
    for path in sorted(folder.glob(f"*/*/{ASL_POSES}")):
        scene = path.parents[1]
        T_world_scan = read_asl_poses(path)
        files = {
            int(match[1]): file
            for file in scene.glob("*/Hokuyo_*.csv")
            if (match := re.fullmatch(r"Hokuyo_(\d+)", file.stem))
        }
        listed += _chain(scene.name, sorted(files.items()), T_world_scan)
    return listed


def read_asl_poses(path: Path) -> dict[int, FloatArray]:
    """(4, 4) ``T_world_scan`` by number: rows of poseId, timestamp, T00, T01, ... T33."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if rows.shape[1] != 18:
        raise ValueError(f"{path}: expected 18 columns, poseId to T33, got {rows.shape[1]}")
    return {int(row[0]): row[2:].reshape(4, 4) for row in rows}


def list_whu_tls(folder: Path) -> list[Listed]:
    """WHU-TLS (Dong et al., ISPRS 2020): the pairs that have a truth.

    ``SCENE/1-RawPointCloud/A.las`` and ``SCENE/3-GroundTruth/A-B/transformation.txt``, the 4x4
    matrix that maps scan A into the frame of scan B.
    """
    listed = []
    for path in sorted(folder.glob("*/3-GroundTruth/*-*/transformation.txt")):
        scene = path.parents[2]
        source, target = path.parent.name.split("-", 1)
        clouds = scene / "1-RawPointCloud"
        listed.append(
            Listed(
                name=f"{scene.name}/{source}-to-{target}",
                set_name=scene.name,
                source=_cloud(clouds, source),
                target=_cloud(clouds, target),
                T_target_source=read_matrix(path),
            )
        )
    return listed


def list_posed_scans(folder: Path) -> list[Listed]:
    """RESSO and the like: ``SCENE/NAME.ply`` (or another format) beside ``SCENE/NAME.txt``, the
    4x4 matrix that maps the scan into the scene's frame; each scan with the one before it."""
    listed = []
    for scene in sorted(path for path in folder.iterdir() if path.is_dir()):
        files = [
            file
            for file in sorted(scene.iterdir(), key=_by_number)
            if file.suffix.lower() in SUPPORTED and file.suffix != ".txt"
        ]
        posed = [(i, file) for i, file in enumerate(files) if file.with_suffix(".txt").exists()]
        T_scene_scan = {i: read_matrix(file.with_suffix(".txt")) for i, file in posed}
        listed += _chain(scene.name, posed, T_scene_scan)
    return listed


def read_matrix(path: Path) -> FloatArray:
    """The (4, 4) matrix in a text file."""
    try:
        matrix = np.loadtxt(path, ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: expected a 4x4 matrix: {error}") from error
    if matrix.shape != (4, 4):
        raise ValueError(f"{path}: expected a 4x4 matrix, got shape {matrix.shape}")
    return matrix


def _chain(
    scene: str, files: list[tuple[int, Path]], T_scene_scan: dict[int, FloatArray]
) -> list[Listed]:
    """Each scan as the source of the one before it."""
    listed = []
    for (first, target), (second, source) in zip(files, files[1:], strict=False):
        for number in (first, second):
            if number not in T_scene_scan:
                raise ValueError(f"{scene}: scan {number} has no pose")
        listed.append(
            Listed(
                name=f"{scene}/{source.stem}-to-{target.stem}",
                set_name=scene,
                source=source,
                target=target,
                T_target_source=invert(T_scene_scan[first]) @ T_scene_scan[second],
                consecutive=True,
            )
        )
    return listed


def _cloud(folder: Path, stem: str) -> Path:
    """The cloud of this name, whatever its format."""
    for extension in SUPPORTED:
        if (folder / f"{stem}{extension}").exists():
            return folder / f"{stem}{extension}"
    raise FileNotFoundError(f"no scan {stem} in {folder}: expected {stem}.las or another format")


def _by_number(path: Path) -> tuple[list[int], str]:
    """Order in which s2 comes before s10."""
    return [int(digits) for digits in re.findall(r"\d+", path.stem)], path.name


ASL = Layout(
    "asl",
    list_asl,
    "SCENE/csv_local/Hokuyo_N.csv and SCENE/csv_global/pose_scanner_leica.csv",
    "https://projects.asl.ethz.ch/datasets, laser registration",
    ProtocolKind.deg2_30cm,
)
WHU_TLS = Layout(
    "whu_tls",
    list_whu_tls,
    "SCENE/1-RawPointCloud/A.las and SCENE/3-GroundTruth/A-B/transformation.txt",
    "https://github.com/WHU-USI3DV/WHU-TLS",
    ProtocolKind.deg5_2m,
)
SCANS = Layout(
    "scans",
    list_posed_scans,
    "SCENE/NAME.ply beside SCENE/NAME.txt, its 4x4 pose",
    "https://3d.bk.tudelft.nl/liangliang/publications/2020/plade/resso.html, or your own",
    ProtocolKind.deg5_2m,
)
