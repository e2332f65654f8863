"""Scenes against geometry worked out by hand: volumes, areas, gaps, symmetries."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.simulation.scenes import furniture
from skipnet.simulation.scenes.placement import (
    GAP_M,
    Station,
    contains,
    furnish,
    separation_m,
    square_m,
)
from skipnet.simulation.scenes.rooms import Opening, Wall, rectangle, reveals, wall_face
from skipnet.simulation.scenes.scenes import FAMILIES, Scene, is_free, make_scene, place_sensors
from skipnet.simulation.scenes.shapes import (
    box,
    convex_polygon,
    cylinder,
    facing,
    join,
    shifted,
    sphere,
    triangle_normals,
)

WITH_FLAT_SURFACES = [family for family in FAMILIES if family != "terrain"]

UNIT_SQUARE_M = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def signed_volume_m3(surfaces):
    """Divergence theorem: positive only if every triangle is wound outward."""
    solid = join(surfaces)
    a, b, c = np.moveaxis(solid.vertices_m[solid.triangles], 1, 0)
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def area_m2(surface):
    a, b, c = np.moveaxis(surface.vertices_m[surface.triangles], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(
    ("surfaces", "volume_m3"),
    [
        (box(np.array([1.0, 2.0, 3.0])), 6.0),
        (cylinder(0.5, 2.0), np.pi * 0.25 * 2.0),
        (sphere(0.5), 4 / 3 * np.pi * 0.125),
    ],
    ids=["box", "cylinder", "sphere"],
)
def test_solids_are_closed_and_wound_outward(surfaces, volume_m3):
    # Away from the origin: a missing or turned face would change the sum.
    assert signed_volume_m3(shifted(surfaces, (3, -2, 5))) == pytest.approx(volume_m3, rel=3e-3)


def test_hidden_faces_are_left_out():
    assert len(box(np.ones(3), hidden=("bottom", "top"))) == 4
    assert len(cylinder(1.0, 1.0, hidden=("bottom", "top"))) == 1


def test_wall_face_has_the_area_of_the_wall_less_its_openings_and_faces_left():
    wall = Wall(np.array([1.0, 1.0]), np.array([1.0, 7.0]), height_m=3.0)
    window, door = Opening(0.5, 1.5, 0.9, 1.2), Opening(3.0, 1.0, 0.0, 2.1)
    face = wall_face(wall, [window, door])
    assert area_m2(face) == pytest.approx(6 * 3 - 1.5 * 1.2 - 1.0 * 2.1)
    normals = triangle_normals(face.vertices_m, face.triangles)
    np.testing.assert_allclose(normals, [[-1, 0, 0]] * len(normals), atol=1e-12)
    assert len(reveals(wall, window, 0.12)) == 4
    assert len(reveals(wall, door, 0.12)) == 3
    assert sum(map(area_m2, reveals(wall, window, 0.12))) == pytest.approx(0.12 * 2 * (1.5 + 1.2))


def test_reveals_face_the_middle_of_the_opening():
    wall = Wall(np.array([0.0, 0.0]), np.array([4.0, 0.0]), height_m=3.0)
    middle_m = np.array([1.5, -0.05, 1.5])
    for face in reveals(wall, Opening(1.0, 1.0, 1.0, 1.0), 0.1):
        normal = triangle_normals(face.vertices_m, face.triangles)[0]
        assert normal @ (middle_m - face.vertices_m[0]) == pytest.approx(0.5)


def test_separation_of_hand_worked_polygons():
    assert separation_m(UNIT_SQUARE_M, UNIT_SQUARE_M + [3.0, 0.0]) == pytest.approx(2.0)
    assert separation_m(UNIT_SQUARE_M, UNIT_SQUARE_M + [0.5, 0.5]) == pytest.approx(-0.5)
    diamond_m = np.array([[3.0, 0.5], [2.5, 1.0], [2.0, 0.5], [2.5, 0.0]])
    assert separation_m(UNIT_SQUARE_M, diamond_m) == pytest.approx(1.0)
    segment_m = np.array([[-2.0, 4.0], [5.0, 4.0]])
    assert separation_m(segment_m, UNIT_SQUARE_M) == pytest.approx(3.0)


def test_contains_on_a_plan_with_a_reflex_corner():
    plan_m = np.array([[0, 0], [4, 0], [4, 4], [2, 4], [2, 2], [0, 2]], dtype=float)
    assert contains(plan_m, np.array([1.0, 1.0]))
    assert contains(plan_m, np.array([3.0, 3.0]))
    assert not contains(plan_m, np.array([1.0, 3.0]))


def test_furniture_keeps_its_gaps():
    cube = box(np.array([1.0, 1.0, 1.0]), hidden=("bottom",))
    corners_m = rectangle((-5, -5), (5, 5), 3.0, 0.1).corners_m
    keep_free_m = square_m(np.zeros(2), 0.8)
    rng = np.random.default_rng(0)
    placed = furnish(rng, corners_m, [lambda _: cube] * 12, [keep_free_m])
    centres_m = join(placed).vertices_m.reshape(-1, 20, 3).mean(axis=1)[:, :2]
    assert len(centres_m) >= 8
    assert np.abs(centres_m).max() <= 5.0 - 0.5 - GAP_M + 1e-9
    # Axis-aligned unit cubes: the larger of the gaps along x and y separates them.
    gaps_m = np.abs(centres_m[:, None] - centres_m).max(axis=-1) - 1.0
    assert gaps_m[~np.eye(len(gaps_m), dtype=bool)].min() >= GAP_M - 1e-9
    assert (np.abs(centres_m).max(axis=1) - 0.5 - 0.8).min() >= GAP_M - 1e-9


@pytest.mark.parametrize(
    "maker",
    [
        furniture.plain_box,
        furniture.stack,
        furniture.turned_stack,
        furniture.tilted_box,
        furniture.table,
        furniture.shelf,
        furniture.drum,
        furniture.pipe,
        furniture.ball,
        furniture.ball_on_drum,
    ],
)
def test_pieces_stand_on_the_floor_and_no_two_faces_touch_in_one_plane(maker):
    for seed in range(5):
        pieces = maker(np.random.default_rng(seed))
        assert join(pieces).vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        flat = [p for p in pieces if not p.is_curved]
        normals = [triangle_normals(p.vertices_m, p.triangles[:1])[0] for p in flat]
        planes = [[*n, n @ p.vertices_m[0]] for n, p in zip(normals, flat, strict=True)]
        planes = np.array(planes).reshape(-1, 4)
        # Legs and boards repeat planes at a distance. Faces of one plane that touch would be one
        # surface if they face the same way, and would hide each other if they face each other.
        same = np.abs(planes[:, None] - planes).max(axis=-1) < 1e-6
        facing = np.abs(planes[:, None] + planes).max(axis=-1) < 1e-6
        for i, j in np.argwhere(np.triu(same | facing, k=1)):
            assert _box_gap_m(flat[i].vertices_m, flat[j].vertices_m) > 0.01


def _box_gap_m(first_m, second_m):
    after = second_m.min(axis=0) - first_m.max(axis=0)
    before = first_m.min(axis=0) - second_m.max(axis=0)
    return np.maximum(after, before).max()


def test_paper_room_has_three_windows_and_two_doors_opposite():
    scene = make_scene("paper_room", 3)
    low_m, high_m = scene.vertices_m.min(axis=0), scene.vertices_m.max(axis=0)
    thickness_m = -5.0 - low_m[1]
    assert 0.10 <= thickness_m <= 0.15
    np.testing.assert_allclose([*low_m, *high_m], [-5, -5 - thickness_m, 0, 5, 5 + thickness_m, 3])
    y_m = scene.vertices_m[scene.triangles][:, :, 1]
    beyond_south = np.unique(scene.surface_of_triangle[(y_m < -5.01).any(axis=1)])
    beyond_north = np.unique(scene.surface_of_triangle[(y_m > 5.01).any(axis=1)])
    assert len(beyond_south) == 3 * 4, "each window shows two jambs, a lintel and a sill"
    assert len(beyond_north) == 2 * 3 + 1, "a door shows two jambs and a lintel, and the floor"


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_gives_the_same_bits_for_a_seed_and_other_scenes_for_others(family):
    first, again, other = make_scene(family, 1), make_scene(family, 1), make_scene(family, 2)
    for name in ("vertices_m", "triangles", "surface_of_triangle", "surface_is_curved"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.vertices_m, other.vertices_m)
    assert set(first.surface_of_triangle) == set(range(len(first.surface_is_curved)))


@pytest.mark.parametrize("family", WITH_FLAT_SURFACES)
def test_flat_surfaces_are_flat(family):
    scene = make_scene(family, 0)
    normals = scene.triangle_normals
    first_triangle = np.unique(scene.surface_of_triangle, return_index=True)[1]
    of_surface = first_triangle[scene.surface_of_triangle]
    flat = ~scene.surface_is_curved[scene.surface_of_triangle]
    np.testing.assert_allclose(normals[flat], normals[of_surface][flat], atol=1e-6)
    anchors_m = scene.vertices_m[scene.triangles[:, 0]]
    offsets_m = np.einsum("ij,ij->i", normals, anchors_m - anchors_m[of_surface])
    assert np.abs(offsets_m[flat]).max() < 1e-6


def test_curved_scenes_hold_curved_surfaces_and_rooms_of_boxes_do_not():
    assert make_scene("curved", 0).surface_is_curved.sum() >= 4
    assert not make_scene("paper_room", 0).surface_is_curved.any()


def test_symmetric_scene_looks_the_same_after_a_quarter_turn():
    vertices_m = make_scene("symmetric", 4).vertices_m
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turned_m = vertices_m @ quarter.T
    gaps_m = np.linalg.norm(turned_m[:, None] - vertices_m, axis=-1).min(axis=1)
    assert gaps_m.max() < 1e-9


@pytest.mark.parametrize("family", FAMILIES)
def test_sensors_stand_upright_in_free_space(family):
    for seed in range(3):
        scene = make_scene(family, seed)
        poses = place_sensors(scene, 3, seed)
        np.testing.assert_array_equal(poses, place_sensors(scene, 3, seed))
        np.testing.assert_allclose(poses[:, :3, 2], [[0, 0, 1]] * 3, atol=1e-12)
        positions_m = poses[:, :3, 3]
        assert ((positions_m[:, 2] >= 1.0) & (positions_m[:, 2] <= 1.8)).all()
        assert np.linalg.norm(scene.vertices_m - positions_m[:, None], axis=-1).min() >= 0.5
        assert is_free(scene, positions_m).all()


def test_second_station_of_the_paper_is_one_to_three_metres_away():
    for seed in range(10):
        positions_m = place_sensors(make_scene("paper_room", seed), 2, seed)[:, :2, 3]
        np.testing.assert_array_equal(positions_m[0], 0.0)
        assert 1.0 <= np.linalg.norm(positions_m[1]) <= 3.0


def test_places_in_or_on_furniture_outside_or_too_near_the_floor_are_not_free():
    scene = make_scene("closed", 0)
    top_m = scene.vertices_m[scene.triangles].mean(axis=1)
    top_m = top_m[(scene.triangle_normals[:, 2] > 0.99) & (top_m[:, 2] > 0.01)][0]
    assert is_free(scene, np.array([[0.0, 0.0, 1.4]])).all()
    bad_m = [top_m - [0, 0, 0.05], top_m + [0, 0, 0.6], [50.0, 0.0, 1.4], [0.0, 0.0, 0.2]]
    assert not is_free(scene, np.array(bad_m)).any()


def test_the_middle_of_a_box_large_enough_to_stand_in_is_not_free():
    floor = facing(
        convex_polygon(np.column_stack([square_m(np.zeros(2), 9.0), np.zeros(4)])), (0, 0, 1)
    )
    parts = [floor, *box(np.array([3.0, 3.0, 3.0]), hidden=("bottom",))]
    whole = join(parts)
    scene = Scene(
        family="box on a floor",
        seed=0,
        vertices_m=whole.vertices_m,
        triangles=whole.triangles,
        surface_of_triangle=np.repeat(np.arange(len(parts)), 2),
        surface_is_curved=np.zeros(len(parts), dtype=bool),
        stations=(Station((0.0, 0.0), 0.0, 0.5),),
    )
    np.testing.assert_array_equal(
        is_free(scene, np.array([[0, 0, 1.4], [5.0, 0, 1.4]])), [False, True]
    )
    with pytest.raises(ValueError, match="no free place for a sensor"):
        place_sensors(scene, 1, 0)


def test_bad_family_and_seed_say_what_is_expected():
    with pytest.raises(ValueError, match=r"'paper_rom'.*did you mean 'paper_room'.*doorway"):
        make_scene("paper_rom", 0)
    with pytest.raises(ValueError, match="seed is -1"):
        make_scene("paper_room", -1)
