"""KITTI odometry: scans of a street 10 m apart, paired as in FCGF (Choy et al., ICCV 2019)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from skipnet.benchmark.datasets.layout import Layout
from skipnet.benchmark.datasets.pairset import Listed
from skipnet.benchmark.options import ProtocolKind
from skipnet.geometry import invert, make_transform
from skipnet.types import FloatArray, Pair

GAP_M = 10.0
"""A pair is a scan and the last one before the car has come farther than this."""
LOOK_AHEAD = 100
"""Scans among which the partner is looked for."""
REACH_M = 0.2
"""Of the ICP that turns the poses of GPS and inertia into the truth."""
WRONG_POSES = {("08", 15, 58)}
"""A pair that FCGF leaves out: its poses are wrong."""
ICP_VOXEL_M = 0.05
ICP_ITERATIONS = 200


def list_kitti(folder: Path) -> list[Listed]:
    """Every sequence with poses: ``sequences/NN/velodyne/NNNNNN.bin``, ``sequences/NN/calib.txt``
    and ``poses/NN.txt``. The usual test takes ``sets=[08,09,10]``."""
    listed = []
    for path in sorted(folder.glob("poses/*.txt")):
        sequence = folder / "sequences" / path.stem
        if sequence.is_dir():
            T_world_scan = read_poses(path, sequence / "calib.txt")
            for first, second in pairs_apart(T_world_scan[:, :3, 3]):
                if (path.stem, first, second) in WRONG_POSES:
                    continue
                listed.append(
                    Listed(
                        name=f"{path.stem}/{second:06d}-to-{first:06d}",
                        set_name=path.stem,
                        source=sequence / "velodyne" / f"{second:06d}.bin",
                        target=sequence / "velodyne" / f"{first:06d}.bin",
                        T_target_source=invert(T_world_scan[first]) @ T_world_scan[second],
                        success_translation_m=2.0,
                    )
                )
    return listed


def read_poses(poses: Path, calibration: Path) -> FloatArray:
    """(N, 4, 4) ``T_world_scan``, from the cameras' poses and the scanner's place among them.

    Each line of the poses is the 3x4 ``T_world_camera``; calib.txt has the 3x4 ``T_camera_scan``
    after ``Tr:``.
    """
    lines = [line for line in calibration.read_text().splitlines() if line.startswith("Tr:")]
    if len(lines) != 1:
        raise ValueError(f"{calibration}: expected one line that starts with Tr:")
    T_camera_scan = _rigid(np.array([lines[0].split()[1:]], dtype=np.float64))
    T_world_camera = _rigid(np.loadtxt(poses, ndmin=2))
    return T_world_camera @ T_camera_scan


def pairs_apart(positions_m: FloatArray) -> list[tuple[int, int]]:
    """Scans that follow each other along the way, just under 10 m apart, one pair after the other.

    >>> pairs_apart(np.array([[3.0 * step, 0.0, 0.0] for step in range(9)]))
    [(0, 3), (4, 7)]
    """
    pairs, first = [], 0
    while first < len(positions_m):
        ahead_m = positions_m[first : first + LOOK_AHEAD] - positions_m[first]
        beyond = np.flatnonzero(np.linalg.norm(ahead_m, axis=1) > GAP_M)
        if len(beyond) == 0:
            first += 1
        else:
            second = first + int(beyond[0]) - 1
            if second > first:
                pairs.append((first, second))
            first = second + 1
    return pairs


def read_scan(path: Path) -> FloatArray:
    """(N, 3) points of a .bin: float32 x, y, z and reflectance, one after the other."""
    values = np.fromfile(path, dtype=np.float32)
    if len(values) == 0 or len(values) % 4:
        raise ValueError(f"{path}: expected float32 x y z reflectance, got {len(values)} numbers")
    return values.reshape(-1, 4)[:, :3].astype(np.float64)


def refine_truth(pair: Pair) -> Pair:
    """The pair with its truth moved to where point-to-point ICP settles, as FCGF does it.

    GPS and inertia know two scans' places to some decimetres only.
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    clouds = []
    for points_m in (pair.source_m, pair.target_m):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
        clouds.append(cloud.voxel_down_sample(ICP_VOXEL_M))
    result = registration.registration_icp(
        *clouds,
        REACH_M,
        pair.T_target_source,
        registration.TransformationEstimationPointToPoint(),
        registration.ICPConvergenceCriteria(max_iteration=ICP_ITERATIONS),
    )
    return replace(pair, T_target_source=np.asarray(result.transformation))


def _rigid(rows: FloatArray) -> FloatArray:
    """(N, 4, 4) transforms of (N, 12) rows of 3x4 matrices."""
    matrices = rows.reshape(-1, 3, 4)
    return make_transform(matrices[:, :, :3], matrices[:, :, 3])


KITTI = Layout(
    "kitti",
    list_kitti,
    "sequences/NN/velodyne/NNNNNN.bin, sequences/NN/calib.txt and poses/NN.txt",
    "https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
    ProtocolKind.deg5_2m,
    read_scan,
    refine_truth,
)
