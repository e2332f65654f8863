"""The judge: hand-made scenes whose overlap and free-space violations can be counted."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import (
    invert,
    make_transform,
    random_rotation,
    rotation_from_vector,
    transform_points,
)
from skipnet.registration.judging.distinct import distinct
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.score import ROUGH
from skipnet.scans.evidence import build_evidence
from skipnet.scans.range_image import build_range_image, octahedral_bin
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.skipmap import build_skipmap

VOXEL_M = 0.2
EYE = np.eye(4)[None]


def evidence_of(points_m, viewpoint_m=(0.0, 0, 0), weights=None, trust=1.0):
    viewpoint_m = None if viewpoint_m is None else np.asarray(viewpoint_m, float)
    skipmap = build_skipmap(points_m, VOXEL_M, viewpoint_m)
    image = None if viewpoint_m is None else build_range_image(points_m, viewpoint_m)
    evidence = build_evidence(skipmap, image, np.random.default_rng(0), trust)
    return evidence if weights is None else evidence.weighing(weights(skipmap))


def plane_points(count, low_m, high_m, seed=0):
    return np.random.default_rng(seed).uniform(low_m, high_m, size=(count, 3))


def box_room(count=40_000, half_m=3.0):
    """The inner faces of a cube around the origin, at places that avoid the voxels' borders."""
    points_m = np.random.default_rng(0).uniform(-half_m, half_m, size=(count, 3))
    face = np.arange(count) % 6
    points_m[np.arange(count), face // 2] = half_m * (2 * (face % 2) - 1)
    return points_m + 0.03


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("paper_room", 1, points=30_000).pair


def flat_bins(directions, bins):
    """Number of the bin of each of (N, 3) directions, line by line."""
    lines, columns = np.array([octahedral_bin(*direction, bins) for direction in directions]).T
    assert min(lines.min(), columns.min()) >= 0 and max(lines.max(), columns.max()) < bins
    return lines * bins + columns


@pytest.mark.parametrize("bins", [4, 33, 256])
def test_octahedral_bins_agree_with_an_independent_inverse_for_every_bin(bins):
    centres = (np.arange(bins) + 0.5) / bins * 2 - 1
    u, v = np.meshgrid(centres, centres)
    z = 1 - np.abs(u) - np.abs(v)
    overhang = np.maximum(-z, 0)  # the corners of the square fold down to the lower half
    x = u - np.copysign(overhang, u)
    y = v - np.copysign(overhang, v)
    inner = np.abs(z) > 1e-9  # a bin cut in half by the equator has no side of its own
    directions = np.stack([x, y, z], axis=-1) * np.linspace(0.1, 50, bins)[:, None, None]
    expected = np.arange(bins * bins).reshape(bins, bins)
    np.testing.assert_array_equal(flat_bins(directions[inner], bins), expected[inner])


def test_octahedral_bins_cover_all_directions_and_keep_neighbours_together():
    directions = np.random.default_rng(0).normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    bins = 32
    flat = flat_bins(directions, bins)
    counts = np.bincount(flat, minlength=bins * bins)
    assert len(counts) == bins * bins and counts.min() > 0
    assert counts.max() < 3 * counts.mean()
    sums = np.stack([np.bincount(flat, directions[:, axis]) for axis in range(3)], axis=1)
    means = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    angle_rad = np.arccos(np.clip((means[flat] * directions).sum(axis=1), -1, 1))
    assert angle_rad.max() < 5 / bins
    special = np.array([[0.0, 0, 0], *np.eye(3), *-np.eye(3), [-1, 0, -0.0], [0, -1, 1e-30]])
    found = flat_bins(special, bins)
    assert ((found >= 0) & (found < 1024)).all()


def test_the_range_image_gives_the_nearest_range_seen_and_0_where_nothing_was():
    viewpoint_m = np.array([1.0, -2.0, 0.5])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(60_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges_m = np.where(directions[:, 0] > 0, 4.0, 7.0)
    seen = directions[:, 2] > -0.5
    image = build_range_image(viewpoint_m + (directions * ranges_m[:, None])[seen], viewpoint_m)
    clear_of_borders = (np.abs(directions[:, 0]) > 0.2) & (np.abs(directions[:, 2] + 0.5) > 0.2)
    # A point is in front where it is nearer than what was seen by a tenth and half a metre.
    T = make_transform(random_rotation(rng), rng.normal(size=3))
    asked = rng.uniform(size=(2, len(directions))) < 0.8
    for range_m in (2.5, 3.05, 3.15, 5.75, 5.85):
        points_m = transform_points(invert(T), viewpoint_m + range_m * directions)
        front = image.in_front(np.stack([T, EYE[0]]), points_m, asked, 0.1, 0.5)
        expected = seen & (range_m < 0.9 * ranges_m - 0.5)
        np.testing.assert_array_equal(
            front[0, clear_of_borders], (expected & asked[0])[clear_of_borders]
        )
        np.testing.assert_array_equal(
            image.in_front(EYE, transform_points(T, points_m), asked[1:], 0.1, 0.5)[0],
            image.in_front(T[None], points_m, asked[1:], 0.1, 0.5)[0],
        )


@pytest.mark.parametrize("opening_rad", [0.25, 0.5])
def test_a_camera_with_as_many_points_in_a_narrow_view_sees_past_smaller_things(opening_rad):
    # A wall 4 m away, but for a square of 7 degrees through which the camera saw far.
    rng = np.random.default_rng(0)
    across = np.tan(rng.uniform(-opening_rad, opening_rad, size=(40_000, 2)))
    hole = (np.abs(across) < np.tan(np.deg2rad(3.5))).all(axis=1)
    depth_m = np.where(hole, 9.0, 4.0)
    points_m = np.column_stack([across, np.ones(len(across))]) * depth_m[:, None]
    image = build_range_image(points_m, np.zeros(3))
    ahead_m = np.array([[0.0, 0.0, 6.0], [0.5 * np.tan(opening_rad) * 3.0, 0.0, 3.0]])
    front = image.in_front(EYE, ahead_m, np.ones((1, 2), dtype=bool), 0.02, 0.1)[0]
    # Through the hole something nearer than 9 m would be in free space, if the bins are fine.
    assert front.tolist() == [True, True]
    every_way = rng.normal(size=(400_000, 3))
    every_way *= 9.0 / np.linalg.norm(every_way, axis=1, keepdims=True)
    apart = every_way[(every_way[:, 2] < 7.0)][:20_000]
    rough = build_range_image(np.concatenate([points_m[::2], apart]), np.zeros(3))
    assert len(rough.nearest_m) < len(image.nearest_m)


def test_a_scan_agrees_with_itself_entirely():
    room = evidence_of(box_room())
    score = Judge(room, room, 4000, 12.0).score(EYE, ROUGH)
    assert score.overlap[0] == pytest.approx(1.0)
    assert score.violation[0] == 0 and score.total[0] == pytest.approx(1.0)


def test_a_panel_in_seen_free_space_is_a_violation_and_counts_by_its_voxels():
    room_m = box_room()
    panel_m = plane_points(4000, [1.03, -1, -1], [1.03, 1, 1])
    target, source = evidence_of(room_m), evidence_of(np.concatenate([room_m, panel_m]))
    is_panel = np.abs(source.points_m[:, 0] - 1.03) < 0.1
    is_panel &= (np.abs(source.points_m[:, 1:]) < 1.1).all(axis=1)
    share = is_panel.mean()
    assert share > 0.01
    score = Judge(source, target, len(source.points_m), 12.0).score(EYE, ROUGH)
    # The target's sensor saw through where the panel is; the source's saw the panel before the
    # wall, and does not blame the target for a wall behind it.
    assert score.violation[0] == pytest.approx(0.5 * share, rel=0.05)
    assert score.overlap[0] == pytest.approx(1 - 0.5 * share, abs=0.01)
    # The contradiction weighs more than its area, and more so with more weight.
    totals = [
        Judge(source, target, 4000, weight).score(EYE, ROUGH).total[0] for weight in (0, 12, 100)
    ]
    assert totals[0] == pytest.approx(score.overlap[0], abs=0.01)
    assert totals[1] < totals[0] - share and totals[2] < 0.6 * totals[1]


def test_what_lies_behind_the_seen_surface_or_in_unseen_directions_violates_nothing():
    wall_m = plane_points(20_000, [3.03, -3, -3], [3.03, 3, 3])
    beyond_m = plane_points(20_000, [5.03, -3, -3], [5.03, 3, 3])
    behind_sensor_m = plane_points(20_000, [-2.03, -3, -3], [-2.03, 3, 3])
    for other_m in (beyond_m, behind_sensor_m):
        score = Judge(evidence_of(other_m, None), evidence_of(wall_m), 4000, 12.0).score(EYE, ROUGH)
        assert score.violation[0] == 0 and score.overlap[0] == 0


def test_without_viewpoints_free_space_is_unknown():
    room_m = box_room()
    panel_m = plane_points(4000, [1.03, -1, -1], [1.03, 1, 1])
    fused = evidence_of(np.concatenate([room_m, panel_m]), None)
    assert Judge(fused, evidence_of(room_m, None), 4000, 12.0).score(EYE, ROUGH).violation[0] == 0


def test_opposite_sides_of_a_thin_wall_never_match():
    wall_m = plane_points(20_000, [2.03, -3, -3], [2.03, 3, 3])
    other_side_m = wall_m + [0.1, 0, 0]
    this, opposite = evidence_of(wall_m), evidence_of(other_side_m, (5.0, 0, 0))
    assert Judge(this, opposite, 4000, 0.0).score(EYE, ROUGH).overlap[0] == 0
    same_side = evidence_of(other_side_m)
    assert Judge(this, same_side, 4000, 0.0).score(EYE, ROUGH).overlap[0] > 0.99
    # Who stood where is unknown: the sides cannot be told apart.
    assert (
        Judge(this, evidence_of(other_side_m, None), 4000, 0.0).score(EYE, ROUGH).overlap[0] > 0.99
    )


@pytest.mark.parametrize(("this", "that"), [(1.0, 0.6), (0.5, 0.5), (0.0, 1.0)])
def test_a_half_trusted_place_tells_sides_and_free_space_by_half(this, that):
    wall_m = plane_points(20_000, [2.03, -3, -3], [2.03, 3, 3])
    front = evidence_of(wall_m, trust=this)
    back = evidence_of(wall_m + [0.1, 0, 0], (5.0, 0, 0), trust=that)
    # In full view of both, the wall agrees with its own back as far as either may be mistaken.
    close = (np.abs(front.points_m[:, 1:]) < 2.5).all(axis=1)
    np.testing.assert_allclose(front.sides[close], this)
    score = Judge(front, back, 4000, 0.0).score(EYE, ROUGH)
    assert score.overlap[0] == pytest.approx(1 - this * that, abs=1e-3)
    room_m, panel_m = box_room(), plane_points(4000, [1.03, -1, -1], [1.03, 1, 1])
    source = evidence_of(np.concatenate([room_m, panel_m]))
    whole, part = (
        Judge(source, evidence_of(room_m, trust=trust), 4000, 0.0).score(EYE, ROUGH).violation[0]
        for trust in (1.0, that)
    )
    assert whole > 0.005 and part == pytest.approx(that * whole)


def test_floors_seen_edge_on_match_whichever_side_is_up():
    floor_m = plane_points(40_000, [-3, -3, 0.03], [3, 3, 0.03])
    low, lower = evidence_of(floor_m, (0, 0, 0.06)), evidence_of(floor_m, (0, 0, 0.0))
    assert Judge(low, lower, 4000, 0.0).score(EYE, ROUGH).overlap[0] == pytest.approx(1.0)
    over, under = evidence_of(floor_m, (0, 0, 2.0)), evidence_of(floor_m, (0, 0, -2.0))
    assert Judge(over, under, 4000, 0.0).score(EYE, ROUGH).overlap[0] == 0


def test_weights_say_how_much_a_voxel_counts():
    shared_m = plane_points(10_000, [3.03, -2, -2], [3.03, 2, 2])
    own_m = plane_points(10_000, [-3.03, -2, -2], [-3.03, 2, 2])
    source = evidence_of(
        np.concatenate([shared_m, own_m]),
        weights=lambda skipmap: np.where(skipmap.centroids_m[:, 0] > 0, 9.0, 1.0),
    )
    heavy = source.weights == 9
    score = Judge(source, evidence_of(shared_m), len(source.points_m), 0.0).score(EYE, ROUGH)
    share = 9 * heavy.sum() / (9 * heavy.sum() + (~heavy).sum())
    assert score.support[0] == pytest.approx(0.5 * (share + 1), rel=1e-5)
    assert score.overlap[0] == pytest.approx(0.5 * (heavy.mean() + 1), rel=1e-5)


def test_swapping_the_scans_swaps_nothing_in_the_score(pair):
    source, target = evidence_of(pair.source_m), evidence_of(pair.target_m)
    rng = np.random.default_rng(0)
    poses = np.stack([pair.T_target_source @ small_motion(rng) for _ in range(8)])
    there = Judge(source, target, 2000, 12.0).score(poses, ROUGH)
    back = Judge(target, source, 2000, 12.0).score(invert(poses), ROUGH)
    np.testing.assert_allclose(there.total, back.total, atol=2e-3)


def small_motion(rng, angle_rad=0.1, shift_m=0.3):
    return make_transform(
        rotation_from_vector(rng.normal(scale=angle_rad, size=3)), rng.normal(scale=shift_m, size=3)
    )


def test_the_truth_outscores_every_other_pose_and_heads_the_shortlist(pair):
    source, target = evidence_of(pair.source_m), evidence_of(pair.target_m)
    rng = np.random.default_rng(1)
    quarter = [np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])]
    turns = [make_transform(quarter[0], np.zeros(3)) @ pair.T_target_source]
    turns += [turns[0] @ turns[0] @ invert(pair.T_target_source)]
    random = [make_transform(random_rotation(rng), rng.normal(size=3)) for _ in range(500)]
    near = [pair.T_target_source @ small_motion(rng) for _ in range(500)]
    candidates = np.stack([*turns, *random, *near, pair.T_target_source])
    total = Judge(source, target, 4000, 12.0).score(candidates, ROUGH).total
    assert total.argmax() == len(candidates) - 1
    best = Judge(source, target, 4000, 12.0).shortlist(candidates)
    np.testing.assert_array_equal(best[0], pair.T_target_source)
    assert 1 <= len(best) <= 20


def test_distinct_keeps_the_first_of_every_group_as_a_double_loop_does():
    rng = np.random.default_rng(2)
    points_m = rng.normal(size=(100, 3)) + [5, 0, 0]
    poses = np.stack([small_motion(rng, 0.1, 0.3) for _ in range(120)])
    expected: list[int] = []
    centres_m = transform_points(poses, points_m.mean(axis=0)[None])[:, 0]
    for row in range(120):
        for earlier in expected:
            relative = poses[earlier, :3, :3].T @ poses[row, :3, :3]
            angle_rad = np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1))
            apart_m = np.linalg.norm(centres_m[row] - centres_m[earlier])
            if angle_rad <= 0.2 and apart_m <= 0.4:
                break
        else:
            expected.append(row)
    np.testing.assert_array_equal(distinct(poses, points_m.mean(axis=0), 0.4, 0.2), expected)
    assert 5 < len(expected) < 115
    assert len(distinct(np.zeros((0, 4, 4)), points_m[0], 0.4)) == 0
