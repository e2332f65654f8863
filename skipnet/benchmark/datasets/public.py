"""The data sets that a folder can hold: how each is read, judged, and where to get it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from skipnet.benchmark.datasets import fragments, kitti, stations
from skipnet.benchmark.datasets.listed import list_pairs
from skipnet.benchmark.datasets.pairset import Listed, PairSet, move_source, select
from skipnet.benchmark.options import DatasetKind, ProtocolKind
from skipnet.clouds.formats.reading import read_points
from skipnet.types import FloatArray, Pair


@dataclass(frozen=True)
class Dataset:
    """A published layout."""

    list_pairs: Callable[[Path], list[Listed]]
    """The pairs in a folder; empty when the folder holds something else."""
    layout: str
    """What the folder must hold, for messages."""
    source: str
    """Where to get it."""
    protocol: ProtocolKind
    """The rule by which results on it are published."""
    read_points: Callable[[Path], FloatArray] = read_points
    finish: Callable[[Pair], Pair] | None = None
    """Last step of reading a pair."""


DATASETS = {
    DatasetKind.folder: Dataset(
        list_pairs,
        "pairs.json",
        "any folder of scans that you list there",
        ProtocolKind.own,
    ),
    DatasetKind.threedmatch: Dataset(
        fragments.list_3dmatch,
        "SCENE/cloud_bin_N.ply and SCENE-evaluation/gt.log (or benchmarks/3DMatch/SCENE/gt.log)",
        "https://3dmatch.cs.princeton.edu, Geometric Registration Benchmark",
        ProtocolKind.rmse_20cm,
    ),
    DatasetKind.threedlomatch: Dataset(
        fragments.list_3dlomatch,
        "SCENE/cloud_bin_N.ply and benchmarks/3DLoMatch/SCENE/gt.log",
        "https://github.com/prs-eth/OverlapPredator, the clouds from https://3dmatch.cs.princeton.edu",
        ProtocolKind.rmse_20cm,
    ),
    DatasetKind.kitti: Dataset(
        kitti.list_kitti,
        "sequences/NN/velodyne/NNNNNN.bin, sequences/NN/calib.txt and poses/NN.txt",
        "https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
        ProtocolKind.deg5_2m,
        kitti.read_scan,
        kitti.refine_truth,
    ),
    DatasetKind.eth: Dataset(
        fragments.list_eth,
        "SCENE/Hokuyo_N.ply and SCENE/gt.log",
        "https://github.com/zgojcic/3DSmoothNet (gazebo and wood)",
        ProtocolKind.deg2_30cm,
    ),
    DatasetKind.asl: Dataset(
        stations.list_asl,
        "SCENE/csv_local/Hokuyo_N.csv and SCENE/csv_global/pose_scanner_leica.csv",
        "https://projects.asl.ethz.ch/datasets, laser registration",
        ProtocolKind.deg2_30cm,
    ),
    DatasetKind.redwood: Dataset(
        fragments.list_redwood,
        "SCENE/mesh_N.ply and SCENE/reg_output.log",
        "http://redwood-data.org/indoor_lidar_rgbd",
        ProtocolKind.deg15_30cm,
    ),
    DatasetKind.whu_tls: Dataset(
        stations.list_whu_tls,
        "SCENE/1-RawPointCloud/A.las and SCENE/3-GroundTruth/A-B/transformation.txt",
        "https://github.com/WHU-USI3DV/WHU-TLS",
        ProtocolKind.deg5_2m,
    ),
    DatasetKind.scans: Dataset(
        stations.list_posed_scans,
        "SCENE/NAME.ply beside SCENE/NAME.txt, its 4x4 pose",
        "https://3d.bk.tudelft.nl/liangliang/publications/2020/plade/resso.html, or your own",
        ProtocolKind.deg5_2m,
    ),
}


def folder_pairs(
    folder: str | Path | None,
    sets: Sequence[str] = (),
    turn: bool = True,
    shift_m: float = 0.0,
    seed: int = 0,
    kind: DatasetKind = DatasetKind.folder,
    most_per_set: int | None = None,
) -> PairSet:
    """The pairs of a data set in a folder, each source first moved at random.

    Shipped pairs are often nearly aligned, which would flatter local methods. The errors that the
    protocols look at do not depend on the turn.

    Args:
        folder: holds the data set in its published layout.
        sets: names of the sets, scenes or sequences to keep; empty keeps all.
        turn: whether to turn the sources, see ``move_source``.
        shift_m: length of the shift, in a random direction.
        seed: seed of the random motions.
        kind: the data set.
        most_per_set: keep at most so many pairs of each set; None keeps all.

    Raises:
        FileNotFoundError: the folder does not hold the data set; the message says where to get it.
        ValueError: a file is not what it should be, or a set is unknown.
    """
    dataset = DATASETS[kind]
    chosen = select(_list(dataset, kind, folder), sets, most_per_set)

    def load(index: int) -> Pair:
        """The chosen pair of that index, read from its files and moved."""
        pair = chosen[index].read(dataset.read_points)
        pair = dataset.finish(pair) if dataset.finish else pair
        return move_source(pair, seed, turn, shift_m) if turn or shift_m else pair

    return PairSet(tuple(pair.name for pair in chosen), load)


def _list(dataset: Dataset, kind: DatasetKind, folder: str | Path | None) -> list[Listed]:
    where = f"data=FOLDER must name one with {dataset.layout}; get it: {dataset.source}"
    if folder is None:
        raise FileNotFoundError(f"dataset={kind.name} needs a folder: {where}")
    try:
        listed = dataset.list_pairs(Path(folder))
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{error}; {where}") from error
    if not listed:
        raise FileNotFoundError(f"no {kind.name} pairs in {folder}: {where}")
    return listed
