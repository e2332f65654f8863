"""Data sets whose truth is a gt.log: 3DMatch, 3DLoMatch, ETH as 3DSmoothNet ships it, Redwood.

A gt.log (Choi et al., CVPR 2015) has five lines per pair: ``i j n`` and the 4x4 matrix that maps
fragment j into the frame of fragment i. So j is the source here and i the target.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from skipnet.benchmark.datasets.layout import Layout
from skipnet.benchmark.datasets.pairset import Listed
from skipnet.benchmark.options import ProtocolKind
from skipnet.types import FloatArray

Indices = tuple[int, int]


def list_3dmatch(folder: Path) -> list[Listed]:
    """3DMatch: ``SCENE/cloud_bin_N.ply`` with ``SCENE-evaluation/gt.log``, as its own site ships
    it, or with ``benchmarks/3DMatch/SCENE/gt.log``, as Predator does."""
    truths = {path.name.removesuffix("-evaluation"): path for path in folder.glob("*-evaluation")}
    return _list_scenes(folder, truths or _benchmarks(folder, "3DMatch"), "cloud_bin_{}.ply")


def list_3dlomatch(folder: Path) -> list[Listed]:
    """3DLoMatch: the clouds of 3DMatch with ``benchmarks/3DLoMatch/SCENE/gt.log``."""
    return _list_scenes(folder, _benchmarks(folder, "3DLoMatch"), "cloud_bin_{}.ply")


def list_eth(folder: Path) -> list[Listed]:
    """ETH's gazebo and wood: ``SCENE/Hokuyo_N.ply`` with ``SCENE/gt.log``."""
    truths = {path.parent.name: path.parent for path in folder.glob("*/gt.log")}
    return _list_scenes(folder, truths, "Hokuyo_{}.ply")


def list_redwood(folder: Path) -> list[Listed]:
    """Redwood's indoor LiDAR-RGBD scans: ``SCENE/mesh_N.ply`` with ``SCENE/reg_output.log``."""
    truths = {path.parent.name: path.parent for path in folder.glob("*/reg_output.log")}
    return _list_scenes(folder, truths, "mesh_{}.ply", log="reg_output.log")


def read_log(path: Path) -> dict[Indices, FloatArray]:
    """The 4x4 matrices ``T_i_j`` of a gt.log by ``(i, j)``."""
    return _read_blocks(path, 4)


def read_information(path: Path) -> dict[Indices, FloatArray]:
    """The 6x6 matrices of a gt.info by ``(i, j)``; empty when there is no such file."""
    return _read_blocks(path, 6) if path.exists() else {}


def read_overlaps(path: Path) -> dict[Indices, float]:
    """The shares of a gt_overlap.log, lines ``i,j,overlap``; empty when there is no such file."""
    if not path.exists():
        return {}
    rows = [re.split(r"[,\s]+", line.strip()) for line in path.read_text().splitlines() if line]
    try:
        return {(int(i), int(j)): float(overlap) for i, j, overlap in rows}
    except ValueError as error:
        raise ValueError(f"{path}: expected lines i,j,overlap: {error}") from error


def _benchmarks(folder: Path, name: str) -> dict[str, Path]:
    return {path.parent.name: path.parent for path in folder.glob(f"benchmarks/{name}/*/gt.log")}


def _list_scenes(
    folder: Path, truths: dict[str, Path], cloud: str, log: str = "gt.log"
) -> list[Listed]:
    """All pairs of all scenes.

    Args:
        folder: holds a folder of clouds per scene.
        truths: scene to the folder with its log.
        cloud: name of a cloud's file, {} for its number.
        log: name of the log.
    """
    listed = []
    for scene, truth in sorted(truths.items()):
        information = read_information(truth / "gt.info")
        overlaps = read_overlaps(truth / "gt_overlap.log")
        for (i, j), T_i_j in read_log(truth / log).items():
            listed.append(
                Listed(
                    name=f"{scene}/{j}-to-{i}",
                    set_name=scene,
                    source=folder / scene / cloud.format(j),
                    target=folder / scene / cloud.format(i),
                    T_target_source=T_i_j,
                    overlap=overlaps.get((i, j)),
                    information=information.get((i, j)),
                    consecutive=j - i == 1,
                )
            )
    return listed


def _read_blocks(path: Path, size: int) -> dict[Indices, FloatArray]:
    """Blocks of one line of indices and ``size`` lines of numbers."""
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]
    if len(lines) % (size + 1):
        raise ValueError(f"{path}: expected {size + 1} lines per pair, got {len(lines)} in all")
    blocks: dict[Indices, FloatArray] = {}
    try:
        for start in range(0, len(lines), size + 1):
            i, j = (int(word) for word in lines[start][:2])
            matrix = np.array(lines[start + 1 : start + size + 1], dtype=np.float64)
            blocks[i, j] = matrix.reshape(size, size)
    except ValueError as error:
        raise ValueError(f"{path}: expected i j n and a {size}x{size} matrix: {error}") from error
    return blocks


THREEDMATCH = Layout(
    "3dmatch",
    list_3dmatch,
    "SCENE/cloud_bin_N.ply and SCENE-evaluation/gt.log (or benchmarks/3DMatch/SCENE/gt.log)",
    "https://3dmatch.cs.princeton.edu, Geometric Registration Benchmark",
    ProtocolKind.rmse_20cm,
)
THREEDLOMATCH = Layout(
    "3dlomatch",
    list_3dlomatch,
    "SCENE/cloud_bin_N.ply and benchmarks/3DLoMatch/SCENE/gt.log",
    "https://github.com/prs-eth/OverlapPredator, the clouds from https://3dmatch.cs.princeton.edu",
    ProtocolKind.rmse_20cm,
)
ETH = Layout(
    "eth",
    list_eth,
    "SCENE/Hokuyo_N.ply and SCENE/gt.log",
    "https://github.com/zgojcic/3DSmoothNet (gazebo and wood)",
    ProtocolKind.deg2_30cm,
)
REDWOOD = Layout(
    "redwood",
    list_redwood,
    "SCENE/mesh_N.ply and SCENE/reg_output.log",
    "http://redwood-data.org/indoor_lidar_rgbd",
    ProtocolKind.deg15_30cm,
)
