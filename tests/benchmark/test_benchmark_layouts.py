"""Every data set's loader on a small folder in exactly its published layout."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skipnet.benchmark.datasets.fragments import ETH, REDWOOD, THREEDLOMATCH, THREEDMATCH
from skipnet.benchmark.datasets.kitti import KITTI, pairs_apart, read_scan, refine_truth
from skipnet.benchmark.datasets.listed import FOLDER
from skipnet.benchmark.datasets.stations import ASL, SCANS, WHU_TLS
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import invert, make_transform, pose_error, transform_points
from skipnet.types import Pair

RNG = np.random.default_rng(3)
WORLD_M = RNG.uniform(-4, 4, (60, 3))


def random_pose(rng, reach_m=2.0):
    return make_transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-reach_m, reach_m, 3))


POSES = [random_pose(RNG) for _ in range(4)]
"""``T_world_scan`` of four scans; each sees the same points."""
SCANS_M = [transform_points(invert(pose), WORLD_M) for pose in POSES]


def between(i, j):
    """The true ``T_i_j``."""
    return invert(POSES[i]) @ POSES[j]


def write_matrix(path, matrix):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix, fmt="%.10f")


def write_blocks(path, blocks):
    """gt.log and gt.info: i, j, n and a matrix."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = []
    for (i, j), matrix in blocks.items():
        lines.append(f"{i}\t {j}\t 4")
        lines += ["\t".join(f"{value:.10e}" for value in row) for row in matrix]
    path.write_text("\n".join(lines) + "\n")


def write_clouds(folder, pattern):
    folder.mkdir(parents=True, exist_ok=True)
    for number, points_m in enumerate(SCANS_M):
        write_cloud(folder / pattern.format(number), points_m)


INFORMATION = np.diag([100.0, 100, 100, 40, 50, 60])


def make_3dmatch(root):
    write_clouds(root / "7-scenes-redkitchen", "cloud_bin_{}.ply")
    truth = root / "7-scenes-redkitchen-evaluation"
    write_blocks(truth / "gt.log", {(0, 1): between(0, 1), (0, 2): between(0, 2)})
    write_blocks(truth / "gt.info", {(0, 1): INFORMATION, (0, 2): INFORMATION})


def make_3dlomatch(root):
    write_clouds(root / "kitchen", "cloud_bin_{}.ply")
    truth = root / "benchmarks" / "3DLoMatch" / "kitchen"
    write_blocks(truth / "gt.log", {(0, 1): between(0, 1), (0, 2): between(0, 2)})
    write_blocks(truth / "gt.info", {(0, 1): INFORMATION, (0, 2): INFORMATION})
    (truth / "gt_overlap.log").write_text("0,1,0.25\n0,2,0.125\n")


def make_eth(root):
    write_clouds(root / "gazebo_summer", "Hokuyo_{}.ply")
    write_blocks(root / "gazebo_summer" / "gt.log", {(0, 1): between(0, 1), (0, 2): between(0, 2)})


def make_redwood(root):
    write_clouds(root / "apartment", "mesh_{}.ply")
    blocks = {(0, 1): between(0, 1), (0, 2): between(0, 2)}
    write_blocks(root / "apartment" / "reg_output.log", blocks)


def make_asl(root, local="csv_local", world="csv_global"):
    folder = root / "apartment"
    for name in (local, world):
        (folder / name).mkdir(parents=True)
    for number, points_m in enumerate(SCANS_M):
        rows = [f"{k}, {x:.8f}, {y:.8f}, {z:.8f}, 0.5" for k, (x, y, z) in enumerate(points_m)]
        header = "timestamp, x, y, z, Intensities"
        (folder / local / f"Hokuyo_{number}.csv").write_text("\n".join([header, *rows]) + "\n")
    header = "poseId, timestamp, " + ", ".join(f"T{r}{c}" for r in range(4) for c in range(4))
    rows = [
        f"{k}, {1e9 + k}, " + ", ".join(f"{v:.10f}" for v in T.ravel()) for k, T in enumerate(POSES)
    ]
    (folder / world / "pose_scanner_leica.csv").write_text("\n".join([header, *rows]) + "\n")


def make_whu_tls(root):
    write_clouds(root / "3-Mountain" / "1-RawPointCloud", "{}.ply")
    truth = root / "3-Mountain" / "3-GroundTruth"
    write_matrix(truth / "1-0" / "transformation.txt", between(0, 1))
    write_matrix(truth / "2-0" / "transformation.txt", between(0, 2))
    write_matrix(truth / "2-0" / "transformation-Dong2018.txt", np.eye(4))


def make_scans(root):
    write_clouds(root / "6a", "s{}.ply")
    for number, pose in enumerate(POSES):
        write_matrix(root / "6a" / f"s{number}.txt", pose)


KITCHEN = "7-scenes-redkitchen"
LAYOUTS = [
    (THREEDMATCH, make_3dmatch, [f"{KITCHEN}/1-to-0", f"{KITCHEN}/2-to-0"]),
    (THREEDLOMATCH, make_3dlomatch, ["kitchen/1-to-0", "kitchen/2-to-0"]),
    (ETH, make_eth, ["gazebo_summer/1-to-0", "gazebo_summer/2-to-0"]),
    (REDWOOD, make_redwood, ["apartment/1-to-0", "apartment/2-to-0"]),
    (ASL, make_asl, [f"apartment/Hokuyo_{k + 1}-to-Hokuyo_{k}" for k in range(3)]),
    (WHU_TLS, make_whu_tls, ["3-Mountain/1-to-0", "3-Mountain/2-to-0"]),
    (SCANS, make_scans, [f"6a/s{k + 1}-to-s{k}" for k in range(3)]),
]  # fmt: skip


@pytest.mark.parametrize(("layout", "make", "names"), LAYOUTS)
@pytest.mark.parametrize("turn", [False, True])
def test_the_truth_brings_the_scans_of_every_layout_together(tmp_path, layout, make, names, turn):
    make(tmp_path)
    pairs = layout.pairs(tmp_path, turn=turn)
    assert list(pairs.names) == names
    for pair in pairs:
        aligned_m = transform_points(pair.T_target_source, pair.source_m)
        assert aligned_m == pytest.approx(pair.target_m, abs=1e-5)


def test_newer_archives_of_asl_name_their_folders_otherwise(tmp_path):
    make_asl(tmp_path, "local_frame", "global_frame")
    assert len(ASL.pairs(tmp_path)) == 3


def test_3dmatch_carries_what_its_rule_needs(tmp_path):
    make_3dmatch(tmp_path)
    first, second = THREEDMATCH.pairs(tmp_path, turn=False)
    assert (first.consecutive, second.consecutive) == (True, False)
    np.testing.assert_allclose(first.information, INFORMATION)
    assert first.overlap is None


def test_3dlomatch_carries_the_overlap(tmp_path):
    make_3dlomatch(tmp_path)
    pairs = THREEDLOMATCH.pairs(tmp_path, turn=False)
    assert [pair.overlap for pair in pairs] == [0.25, 0.125]


def test_predators_layout_of_3dmatch_is_read_too(tmp_path):
    write_clouds(tmp_path / "kitchen", "cloud_bin_{}.ply")
    truth = tmp_path / "benchmarks" / "3DMatch" / "kitchen"
    write_blocks(truth / "gt.log", {(0, 2): between(0, 2)})
    assert THREEDMATCH.pairs(tmp_path).names == ("kitchen/2-to-0",)


# --- KITTI ----------------------------------------------------------------------------------------


@pytest.fixture
def kitti(tmp_path):
    """A car that drives 4 m a scan along the camera's z axis, past a still scene."""
    scene_m = np.random.default_rng(0).uniform([-30, -30, -2], [30, 30, 4], (4000, 3))
    T_camera_scan = make_transform(
        np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.1, -0.2, -0.3])
    )
    velodyne = tmp_path / "sequences" / "08" / "velodyne"
    velodyne.mkdir(parents=True)
    (tmp_path / "poses").mkdir()
    poses = []
    for number in range(5):
        T_world_camera = make_transform(np.eye(3), np.array([0, 0, 4.0 * number]))
        poses.append(T_world_camera[:3].ravel())
        seen_m = transform_points(invert(T_world_camera @ T_camera_scan), scene_m)
        np.column_stack([seen_m, np.ones(len(seen_m))]).astype(np.float32).tofile(
            velodyne / f"{number:06d}.bin"
        )
    np.savetxt(tmp_path / "poses" / "08.txt", poses)
    row = " ".join(str(value) for value in T_camera_scan[:3].ravel())
    zeros = " ".join(["0"] * 12)
    (velodyne.parent / "calib.txt").write_text(f"P0: {zeros}\nTr: {row}\n")
    return tmp_path


def test_kitti_pairs_the_last_scan_within_10_m(kitti):
    (pair,) = KITTI.pairs(kitti, turn=False)
    assert pair.name == "08/000002-to-000000"  # 8 m; the next scan would be 12 m away
    aligned_m = transform_points(pair.T_target_source, pair.source_m)
    assert aligned_m == pytest.approx(pair.target_m, abs=1e-3)
    # 8 m ahead: the scanner's x axis is the camera's z.
    assert pair.T_target_source[:3, 3] == pytest.approx([8, 0, 0], abs=1e-3)


def test_the_pair_with_wrong_poses_is_left_out(kitti):
    """Scans 0 to 14 stand still, 15 to 58 stand 11 m on, 59 another 11 m."""
    z_m = [0.0] * 15 + [11.0] * 44 + [22.0]
    poses = [make_transform(np.eye(3), np.array([0, 0, z]))[:3].ravel() for z in z_m]
    np.savetxt(kitti / "poses" / "08.txt", poses)
    assert KITTI.pairs(kitti).names == ("08/000014-to-000000",)


def test_pairs_follow_fcgf_on_a_hand_worked_track():
    """0, 6, 9 | 15 (> 10 from 0): pair (0, 2), next from 3; 15, 26: 11 m at once, no pair."""
    x_m = np.array([0.0, 6, 9, 15, 26, 30, 37])
    positions_m = np.column_stack([x_m, np.zeros((7, 2))])
    assert pairs_apart(positions_m) == [(0, 2), (4, 5)]


def test_the_truth_of_kitti_is_mended_by_icp():
    points_m = np.random.default_rng(0).uniform(-3, 3, (3000, 3))
    T_true = random_pose(np.random.default_rng(1))
    source_m = transform_points(invert(T_true), points_m)
    T_gps = make_transform(np.eye(3), np.array([0.04, -0.03, 0.02])) @ T_true
    pair = refine_truth(Pair("a", "08", source_m, points_m, T_gps))
    assert pose_error(pair.T_target_source, T_true)[1] < 1e-3


def test_a_truncated_scan_of_kitti_is_refused(tmp_path):
    (tmp_path / "0.bin").write_bytes(b"\0" * 30)
    with pytest.raises(ValueError, match="reflectance"):
        read_scan(tmp_path / "0.bin")


# --- what is not there, or not right --------------------------------------------------------------


@pytest.mark.parametrize("layout", [FOLDER, KITTI, *(row[0] for row in LAYOUTS)])
@pytest.mark.parametrize("folder", [None, "empty"])
def test_an_absent_data_set_is_one_line_that_says_where_to_get_it(tmp_path, layout, folder):
    with pytest.raises(FileNotFoundError, match="data=FOLDER") as caught:
        layout.pairs(folder and tmp_path)
    assert layout.source in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["0 1 4\n1 0 0 0\n", "0 1 4\n" + "1 0 0\n" * 4, "a b c\n" * 5])
def test_a_broken_log_is_named(tmp_path, text):
    make_eth(tmp_path)
    (tmp_path / "gazebo_summer" / "gt.log").write_text(text)
    with pytest.raises(ValueError, match="gt.log: expected"):
        ETH.pairs(tmp_path)


def test_a_scan_without_pose_is_named(tmp_path):
    make_asl(tmp_path)
    path = tmp_path / "apartment" / "csv_global" / "pose_scanner_leica.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")
    with pytest.raises(ValueError, match="scan 3 has no pose"):
        ASL.pairs(tmp_path)


def test_at_most_so_many_pairs_of_each_set_spread_over_the_list(tmp_path):
    make_scans(tmp_path)
    pairs = SCANS.pairs(tmp_path, most_per_set=2)
    assert pairs.names == ("6a/s1-to-s0", "6a/s3-to-s2")
