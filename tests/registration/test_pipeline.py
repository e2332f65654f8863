"""skipnet.register as its users call it: truths, invariants, what no one can know, bad input."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import skipnet
from skipnet.geometry import (
    invert,
    make_transform,
    pose_error,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.simulation.scanning.pairs import simulate_pair

ROOT = Path(__file__).parents[2]
MAX_ROTATION_DEG, MAX_SHIFT_M = 0.01, 1e-4  # within these two poses count as the same


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=30_000).pair


@pytest.fixture(scope="module")
def result(pair):
    return skipnet.register(pair.source_m, pair.target_m)


def assert_same_pose(T, expected):
    rotation_rad, shift_m = pose_error(T, expected)
    assert np.rad2deg(rotation_rad) < MAX_ROTATION_DEG and shift_m < MAX_SHIFT_M


def assert_right(result, pair):
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    assert rotation_rad < pair.success_rotation_rad
    assert translation_m < pair.success_translation_m


def random_motion(seed, scale_m=5.0):
    rng = np.random.default_rng(seed)
    return make_transform(random_rotation(rng), rng.normal(scale=scale_m, size=3))


def test_a_simulated_room_comes_out_right_with_every_field_filled(result, pair):
    assert_right(result, pair)
    assert result.status == "registered" and 0.8 <= result.confidence <= 1
    assert "agree" in result.reason and "\n" not in result.reason
    for T in (result.T_target_source, result.T_target_source_coarse):
        assert T.shape == (4, 4) and T.dtype == np.float64
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        np.testing.assert_array_equal(T[3], [0, 0, 0, 1])
    assert list(result.timings_s)[:3] == ["validate", "denoise", "skip-map"]
    assert min(result.timings_s.values()) >= 0
    np.testing.assert_allclose(result.details["source_viewpoint_m"], 0, atol=1e-9)
    np.testing.assert_allclose(result.details["target_viewpoint_m"], 0, atol=1e-9)


@pytest.mark.parametrize("family", ["oblique", "curved", "closed"])
def test_other_rooms_in_any_attitude_come_out_right(family):
    pair = simulate_pair(family, 3, rotation="any", points=30_000).pair
    result = skipnet.register(pair.source_m, pair.target_m)
    assert result.status == "registered"
    assert_right(result, pair)


# --- what must not matter -------------------------------------------------------------------------


def test_swapping_source_and_target_gives_the_inverse(result, pair):
    swapped = skipnet.register(pair.target_m, pair.source_m)
    assert_same_pose(invert(swapped.T_target_source), result.T_target_source)
    assert_same_pose(invert(swapped.T_target_source_coarse), result.T_target_source_coarse)
    assert (swapped.status, swapped.reason) == (result.status, result.reason)
    assert swapped.confidence == pytest.approx(result.confidence)


@pytest.mark.parametrize("scale_m", [0.0, 5.0, 100_000.0], ids=["turned", "moved", "map grid"])
def test_moving_either_cloud_beforehand_moves_the_answer_along(result, pair, scale_m):
    T = random_motion(7, scale_m)
    source_m = transform_points(T, pair.source_m.astype(np.float64))
    moved = skipnet.register(source_m, pair.target_m, source_viewpoint=T[:3, 3])
    assert_same_pose(moved.T_target_source @ T, result.T_target_source)
    target_m = transform_points(T, pair.target_m.astype(np.float64))
    moved = skipnet.register(pair.source_m, target_m, target_viewpoint=list(T[:3, 3]))
    assert_same_pose(invert(T) @ moved.T_target_source, result.T_target_source)
    np.testing.assert_allclose(moved.details["target_viewpoint_m"], T[:3, 3], atol=1e-6)
    assert moved.confidence == pytest.approx(result.confidence, abs=1e-3)


def test_viewpoints_need_not_be_known(result, pair):
    for viewpoint in (None, "auto"):
        T = random_motion(8)
        moved_m = transform_points(T, pair.source_m.astype(np.float64))
        unknown = skipnet.register(moved_m, pair.target_m, source_viewpoint=viewpoint)
        assert_same_pose(unknown.T_target_source @ T, result.T_target_source)
        assert unknown.status == "registered"
        if viewpoint is None:
            assert unknown.details["source_viewpoint_m"] is None


def test_the_order_and_the_type_of_the_points_do_not_matter(result, pair):
    rng = np.random.default_rng(2)
    shuffled = skipnet.register(rng.permutation(pair.source_m), rng.permutation(pair.target_m))
    assert_same_pose(shuffled.T_target_source, result.T_target_source)
    as_lists = skipnet.register(pair.source_m.tolist(), pair.target_m.astype(np.float64))
    np.testing.assert_array_equal(as_lists.T_target_source, result.T_target_source)


def test_the_same_seed_gives_the_same_bits_and_another_seed_the_same_pose(result, pair):
    again = skipnet.register(pair.source_m, pair.target_m)
    np.testing.assert_array_equal(again.T_target_source, result.T_target_source)
    assert (again.confidence, again.reason) == (result.confidence, result.reason)
    other = skipnet.register(pair.source_m, pair.target_m, seed=5)
    assert_same_pose(other.T_target_source, result.T_target_source)


def test_the_number_of_threads_does_not_matter(tmp_path):
    code = (
        "import skipnet, hashlib; from skipnet.simulation.scanning.pairs import simulate_pair;"
        "p = simulate_pair('paper_room', 4, points=20_000).pair;"
        "r = skipnet.register(p.source_m, p.target_m);"
        "print(hashlib.sha256(r.T_target_source.tobytes()).hexdigest(), r.confidence)"
    )
    outputs = []
    for threads in ("1", "3"):
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        run = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env={"PATH": "/usr/bin:/bin", **dict.fromkeys(names, threads)},
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert run.returncode == 0, run.stderr
        outputs.append(run.stdout)
    assert outputs[0] == outputs[1]


# --- what no one can know -------------------------------------------------------------------------


def free_axis_of(result):
    return np.array(result.details["free_directions"])


def plane_scan(seed, walls, count=15_000):
    """Points on rectangles ((low corner), (high corner)), with 2 mm noise; the sensor at 0."""
    rng = np.random.default_rng(seed)
    points_m = [rng.uniform(low, high, size=(count, 3)) for low, high in walls]
    points_m = np.concatenate(points_m)
    return points_m + rng.normal(scale=0.002, size=points_m.shape)


PARALLEL = [([-6, -1.5, -1], [6, -1.5, 2]), ([-6, 2, -1], [6, 2, 2])]


@pytest.mark.parametrize(
    ("walls", "free"),
    [(PARALLEL[:1], 2), (PARALLEL, 2), ([*PARALLEL, ([-6, -1.5, -1], [6, 2, -1])], 1)],
    ids=["one plane", "two parallel planes", "a corridor"],
)
def test_planes_that_leave_directions_free_are_ambiguous_and_the_axes_are_named(walls, free):
    T = make_transform(rotation_from_vector(np.array([0, 0, 0.3])), np.array([0.8, 0.2, 0.1]))
    source_m = transform_points(T, plane_scan(0, walls))
    result = skipnet.register(source_m, plane_scan(1, walls), source_viewpoint=T[:3, 3])
    assert result.status == "ambiguous"
    assert "position along" in result.reason and "target's frame" in result.reason
    axes = free_axis_of(result)
    assert len(axes) == free
    # Across the walls the position is known, along them it is not.
    np.testing.assert_allclose(axes[:, 1], 0, atol=0.02)
    if free == 1:
        np.testing.assert_allclose(np.abs(axes), [[1, 0, 0]], atol=0.02)
    # Turned by 180 degrees a corridor looks the same: what is known is where its walls are.
    beside_m = np.array([[0, low[1], 0] for low, high in walls if low[1] == high[1]])
    found_m = transform_points(result.T_target_source @ T, beside_m)[:, 1]
    np.testing.assert_allclose(np.sort(found_m), np.sort(beside_m[:, 1]), atol=0.01)


def test_the_free_axis_is_named_in_the_targets_frame_whichever_scan_that_is():
    pair = simulate_pair("corridor", 1, points=30_000).pair
    result = skipnet.register(pair.source_m, pair.target_m)
    swapped = skipnet.register(pair.target_m, pair.source_m)
    assert result.status == swapped.status == "ambiguous"
    axis, other = free_axis_of(result)[0], free_axis_of(swapped)[0]
    np.testing.assert_allclose(np.abs(axis), [1, 0, 0], atol=0.01)
    turned = pair.T_target_source[:3, :3].T @ axis
    np.testing.assert_allclose(np.abs(turned @ other), 1, atol=1e-3)


def test_a_symmetric_room_lists_the_poses_that_explain_it_too():
    pair = simulate_pair("symmetric", 1, points=30_000).pair
    result = skipnet.register(pair.source_m, pair.target_m)
    assert result.status == "ambiguous" and "poses explain the data" in result.reason
    poses = [result.T_target_source, *np.array(result.details["alternatives_T_target_source"])]
    errors = [pose_error(T, pair.T_target_source) for T in poses]
    assert min(rotation_rad for rotation_rad, _ in errors) < np.deg2rad(0.5)
    assert result.confidence <= 0.5


@pytest.mark.parametrize("seed", range(3))
def test_scans_of_two_different_rooms_are_not_registered(seed):
    source = simulate_pair("paper_room", 10 + seed, points=30_000).pair
    target = simulate_pair(("paper_room", "oblique", "closed")[seed], 20 + seed, points=30_000).pair
    result = skipnet.register(source.source_m, target.target_m)
    assert result.status != "registered"
    assert result.confidence < 0.8 and result.reason


@pytest.mark.parametrize("count", [3, 20, 500])
def test_too_little_to_go_by_is_a_result_not_an_error(count):
    rng = np.random.default_rng(count)
    source, target = rng.normal(size=(2, count, 3))
    result = skipnet.register(source, target)
    assert result.status in ("failed", "ambiguous") and result.reason
    assert np.isfinite(result.T_target_source).all()


def test_a_scan_that_is_all_lines_at_the_coarse_level_is_a_result_too():
    rng = np.random.default_rng(0)
    angle, across_m = rng.uniform(0, 2 * np.pi, 12_000), rng.uniform(-0.025, 0.025, 12_000)
    lift_m = rng.normal(scale=5e-4, size=12_000)
    ring_m = np.stack([(5 + across_m) * np.cos(angle), (5 + across_m) * np.sin(angle), lift_m], 1)
    patch_m = rng.uniform([0, 0, 0], [1.0, 0.6, 1e-3], (3000, 3))
    for source_m, target_m in ((patch_m, ring_m), (ring_m, patch_m)):
        assert skipnet.register(source_m, target_m, voxel_size_m=0.1).status != "registered"


# --- options and bad input ------------------------------------------------------------------------


@pytest.mark.parametrize("generator", [Generator.planes, Generator.descriptors])
def test_each_generator_registers_a_room_by_itself(pair, generator):
    config = RegistrationConfig(generators=[generator])
    assert_right(skipnet.register(pair.source_m, pair.target_m, config=config), pair)


def test_voxel_size_and_denoising_can_be_chosen(pair):
    result = skipnet.register(pair.source_m, pair.target_m, voxel_size_m=0.25)
    assert result.details["voxel_size_m"] == 0.25
    assert_right(result, pair)
    config = RegistrationConfig(denoise=True)
    denoised = skipnet.register(pair.source_m, pair.target_m, config=config)
    assert denoised.timings_s["denoise"] > result.timings_s["denoise"]
    assert_right(denoised, pair)


GOOD = np.random.default_rng(0).normal(size=(100, 3))


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        (np.zeros((5, 2)), GOOD, r"source: .*expected numbers of shape \(N, 3\)"),
        (GOOD, [["a", "b", "c"]] * 9, "target: .*expected numbers"),
        (GOOD, GOOD[:2], "target: got 2 points: a plane needs 3"),
        (np.where(GOOD > 2, np.nan, GOOD), GOOD, "source: .* hold NaN or infinity"),
        (GOOD, np.full((100, 3), np.inf), "target: 100 of 100 points hold NaN or infinity"),
        (GOOD[:, :1] * [1.0, 2, 3], GOOD, "source: all 100 points lie on one line"),
        (np.ma.masked_greater(GOOD, 1), GOOD, "source: some numbers are masked"),
    ],
)
def test_bad_clouds_raise_what_was_given_and_what_is_expected(source, target, words):
    with pytest.raises(ValueError, match=words):
        skipnet.register(source, target)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("voxel_size_m", 0.0, "voxel_size_m"),
        ("voxel_size_m", -0.1, "voxel_size_m"),
        ("voxel_size_m", float("nan"), "voxel_size_m"),
        ("voxel_size_m", float("inf"), "expected a positive length"),
        ("voxel_size_m", "a", "expected a positive length"),
        ("voxel_size_m", 1e-9, "larger voxel_size_m"),
        ("source_viewpoint", "origin", "source_viewpoint"),
        ("source_viewpoint", [1.0, 2.0], "source_viewpoint"),
        ("target_viewpoint", [0.0, 0.0, float("nan")], "target_viewpoint"),
        ("seed", -1, "seed=-1: expected a whole number"),
        ("seed", 1.5, "seed=1.5: expected a whole number"),
        ("seed", None, "seed=None: expected a whole number"),
        ("config", {"device": "cpu"}, "expected a RegistrationConfig"),
    ],
)
def test_bad_options_name_the_option(option, value, words):
    with pytest.raises(ValueError, match=words):
        skipnet.register(GOOD, GOOD, **{option: value})


def test_a_name_in_place_of_a_list_is_refused():
    with pytest.raises(ValueError, match="generators=planes: expected members"):
        RegistrationConfig(generators="planes")
    with pytest.raises(ValueError, match="two or more in a list"):
        skipnet.register_many("a.ply")


def test_other_places_that_both_scans_saw_a_kilometre_away_do_not_matter():
    pair = simulate_pair("paper_room", 1, points=30_000).pair
    rng, T = np.random.default_rng(0), pair.T_target_source
    middles_m = 1000 * np.array([[1, 0.2, 0.1], [-0.5, 1, 0.2], [0.3, -1, 0.5]])
    far_m = np.concatenate([middle_m + rng.normal(size=(700, 3)) for middle_m in middles_m])
    source_m = np.concatenate([pair.source_m, far_m])
    target_m = np.concatenate([pair.target_m, transform_points(T, far_m)])
    result = skipnet.register(source_m, target_m)
    assert result.status == "registered"
    rotation_rad, translation_m = pose_error(result.T_target_source, T)
    assert rotation_rad < np.deg2rad(0.5) and translation_m < 0.03
