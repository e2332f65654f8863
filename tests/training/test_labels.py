"""True classes against hand-worked scenes: a room's corner, a box, a step, a cylinder."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.geometry import make_transform, random_rotation
from skipnet.simulation.scanning.scanner import SCANNERS
from skipnet.simulation.scenes.scenes import make_scene, place_sensors
from skipnet.training.data.labels import LabelRule, classify_surfaces, label_positions
from skipnet.training.data.visibility import (
    VisibleSurface,
    beam_density,
    sample_scene,
    visible_surface,
)
from skipnet.types import FeatureClass

VOXEL_M = 0.1
RULE = LabelRule(radius_voxels=2.5, min_area_voxels2=2.5, min_beams=0.0)
AXES = np.eye(3)


def face(normal_axis: int, sign: float, first: tuple, second: tuple, surface: int) -> dict:
    """Samples of the axis-aligned rectangle at 0 along one axis; ranges along the two others."""
    step_m = VOXEL_M / 4
    u, v = (np.arange(low + step_m / 2, high, step_m) for low, high in (first, second))
    u, v = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    others = [axis for axis in range(3) if axis != normal_axis]
    points_m = np.zeros((len(u), 3))
    points_m[:, others[0]], points_m[:, others[1]] = u, v
    normals = np.tile(sign * AXES[normal_axis], (len(u), 1))
    return {"points_m": points_m, "normals": normals, "surfaces": np.full(len(u), surface)}


def join(*faces: dict) -> VisibleSurface:
    parts = {key: np.concatenate([one[key] for one in faces]) for key in faces[0]}
    count = len(parts["surfaces"])
    return VisibleSurface(
        **parts, areas_m2=np.full(count, (VOXEL_M / 4) ** 2), beams=np.full(count, 1.0)
    )


def label_at(position_m, visible: VisibleSurface, rule: LabelRule = RULE) -> int:
    return int(label_positions(np.array([position_m]), visible, VOXEL_M, rule)[0])


PLUS, MINUS, BOTH = (0.0, 1.0), (-1.0, 0.0), (-1.0, 1.0)


def room_corner(sign: float) -> VisibleSurface:
    """Three quarter planes x = 0, y = 0, z = 0; sign 1 seen from inside, -1 from outside."""
    return join(*(face(axis, sign, PLUS, PLUS, axis) for axis in range(3)))


def box_on_floor() -> VisibleSurface:
    """A box x < 0, y < 0, z > 0 standing on the floor z = 0."""
    return join(
        face(0, 1.0, MINUS, PLUS, 0),
        face(1, 1.0, MINUS, PLUS, 1),
        face(2, 1.0, PLUS, BOTH, 2),
        face(2, 1.0, MINUS, PLUS, 2),
    )


def test_the_five_classes_where_they_are_clear() -> None:
    assert label_at([0, 0, 0], room_corner(1.0)) == FeatureClass.FIRST_CORNER
    assert label_at([0, 0, 0], room_corner(-1.0)) == FeatureClass.SECOND_CORNER
    assert label_at([0, 0, 0], box_on_floor()) == FeatureClass.OTHER_CORNER
    assert label_at([0.5, 0, 0], room_corner(1.0)) == FeatureClass.EDGE
    assert label_at([0.5, 0, 0], room_corner(-1.0)) == FeatureClass.EDGE
    assert label_at([0.5, 0.5, 0], room_corner(1.0)) == FeatureClass.PLANE


def test_nothing_visible_has_no_class() -> None:
    assert label_at([3.0, 3.0, 3.0], room_corner(1.0)) == -1


def test_a_class_ends_where_the_visible_area_of_the_third_surface_does() -> None:
    # At distance d of the corner along an edge, the wall shows a circle segment's half.
    def shown_voxels2(distance_voxels: float) -> float:
        radius = RULE.radius_voxels
        angle = np.arccos(distance_voxels / radius)
        # The wall x = 0 is cut at distance d from the ball's centre: a quarter of the disc left.
        return np.pi * (radius**2 - distance_voxels**2) / 4 if angle > 0 else 0.0

    for distance_voxels in (1.2, 1.5, 2.0, 2.3):
        expected = (
            FeatureClass.FIRST_CORNER
            if shown_voxels2(distance_voxels) >= RULE.min_area_voxels2
            else FeatureClass.EDGE
        )
        position_m = [distance_voxels * VOXEL_M, 0, 0]
        assert label_at(position_m, room_corner(1.0)) == expected, distance_voxels


def test_labels_turn_with_the_frame() -> None:
    rng = np.random.default_rng(3)
    R = random_rotation(rng)
    scene = box_on_floor()
    turned = VisibleSurface(
        scene.points_m @ R.T, scene.normals @ R.T, scene.surfaces, scene.areas_m2, scene.beams
    )
    positions_m = rng.uniform(-0.4, 0.4, (200, 3))
    expected = label_positions(positions_m, scene, VOXEL_M, RULE)
    assert len(np.unique(expected)) >= 4
    got = label_positions(positions_m @ R.T, turned, VOXEL_M, RULE)
    np.testing.assert_array_equal(got, expected)


def test_surfaces_in_one_plane_count_once_and_a_step_twice() -> None:
    left, right = face(2, 1.0, MINUS, BOTH, 0), face(2, 1.0, PLUS, BOTH, 1)
    assert label_at([0, 0, 0], join(left, right)) == FeatureClass.PLANE
    raised = {**right, "points_m": right["points_m"] + [0, 0, 0.1]}
    assert label_at([0, 0, 0.05], join(left, raised)) == FeatureClass.EDGE


def test_what_few_beams_meet_does_not_count() -> None:
    scene = room_corner(1.0)
    poor = VisibleSurface(
        scene.points_m,
        scene.normals,
        scene.surfaces,
        scene.areas_m2,
        np.where(scene.surfaces == 2, 0.001, 1.0),
    )
    rule = LabelRule(2.5, 2.5, min_beams=3.0)
    assert label_at([0, 0, 0], scene, rule) == FeatureClass.FIRST_CORNER
    assert label_at([0, 0, 0], poor, rule) == FeatureClass.EDGE


def test_oblique_walls_are_concave_or_convex_by_their_sides() -> None:
    # Three planes through the origin with random normals; the visible parts lie in front of or
    # behind each other by construction.
    rng = np.random.default_rng(0)
    for _ in range(20):
        edges = np.linalg.qr(rng.normal(size=(3, 3)))[0] + 0.3 * rng.normal(size=(3, 3))
        centres = np.stack([edges[(k + 1) % 3] + edges[(k + 2) % 3] for k in range(3)])
        normals = np.stack([np.cross(edges[(k + 1) % 3], edges[(k + 2) % 3]) for k in range(3)])
        normals *= np.sign(np.einsum("ki,ki->k", normals, edges))[:, None]
        here = np.ones((1, 3), dtype=bool)
        assert classify_surfaces(centres[None], normals[None], here) == FeatureClass.FIRST_CORNER
        assert classify_surfaces(centres[None], -normals[None], here) == FeatureClass.SECOND_CORNER
        mixed = normals * np.array([[1], [1], [-1]])
        assert classify_surfaces(centres[None], mixed[None], here) == FeatureClass.OTHER_CORNER


def test_samples_cover_every_triangle_by_its_area() -> None:
    scene = make_scene("paper_room", 0)
    points_m, normals, triangle, areas_m2 = sample_scene(scene, 0.05)
    a, b, c = (scene.vertices_m[scene.triangles[:, k]] for k in range(3))
    area_m2 = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    np.testing.assert_allclose(
        np.bincount(triangle, weights=areas_m2, minlength=len(area_m2)), area_m2
    )
    height_m = np.einsum("si,si->s", points_m - a[triangle], normals)
    assert np.abs(height_m).max() < 1e-9


def test_the_sensor_sees_only_what_faces_it_unhidden_and_in_its_field() -> None:
    scene = make_scene("closed", 1)
    T_world_sensor = place_sensors(scene, 2, 0)[1]
    scanner = SCANNERS["rings"]
    visible = visible_surface(scene, scanner, T_world_sensor, 0.1)
    elevation_rad = np.arcsin(visible.points_m[:, 2] / np.linalg.norm(visible.points_m, axis=1))
    assert np.abs(elevation_rad).max() <= np.deg2rad(15.0) + 1e-9
    assert (np.einsum("si,si->s", visible.normals, visible.points_m) < 0).all()
    # An oracle that knows nothing of our sampling: rays to the samples end there.
    origin_m = T_world_sensor[:3, 3]
    world_m = visible.points_m @ T_world_sensor[:3, :3].T + origin_m
    hits = scene.raycaster.cast(origin_m, world_m - origin_m)
    assert np.quantile(np.abs(hits.distances - 1), 0.99) < 2e-3


@pytest.mark.parametrize("name", ["terrestrial", "rings"])
def test_beam_density_sums_to_all_beams(name: str) -> None:
    scanner = SCANNERS[name]
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(400_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    beams = 4 * np.pi * beam_density(scanner, directions).mean()
    assert beams == pytest.approx(scanner.channels * scanner.azimuth_steps, rel=0.03)


def test_beams_on_a_surface_are_those_that_a_scan_sends_there() -> None:
    from skipnet.simulation.scanning.scanner import scan

    scene = make_scene("closed", 0)
    T_world_sensor = make_transform(np.eye(3), np.array([0.0, 0.0, 1.5]))
    scanner = SCANNERS["terrestrial"]
    visible = visible_surface(scene, scanner, T_world_sensor, 0.05)
    result = scan(scene, scanner, T_world_sensor, 0)
    counted = np.bincount(result.surface_of_point)
    expected = np.bincount(visible.surfaces, weights=visible.beams, minlength=len(counted))
    large = counted > 2000
    assert large.sum() >= 5
    ratio = counted[large] / (expected[: len(counted)][large] * (1 - scanner.dropout))
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)
