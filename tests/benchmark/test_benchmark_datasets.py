"""Pair sets: the truth they carry, repeatability, and folders that are not what they should be."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skipnet.benchmark.datasets.disturbed import disturb, disturbed_pairs
from skipnet.benchmark.datasets.listed import FOLDER
from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.datasets.simulated import simulated_pairs
from skipnet.benchmark.options import DisturbanceConfig
from skipnet.clouds.formats.writing import write_cloud
from skipnet.geometry import invert, make_transform, rotation_angle_rad, transform_points
from skipnet.metrics.poses import measured_overlap
from skipnet.types import Pair


@pytest.fixture
def truth():
    return make_transform(Rotation.from_euler("z", 0.3).as_matrix(), np.array([1.0, -2.0, 0.5]))


@pytest.fixture
def folder(tmp_path, truth):
    """Two sets of one pair each; source and target hold the same points."""
    target_m = np.random.default_rng(0).uniform(-2, 2, (50, 3))
    for name in ("hall", "attic"):
        (tmp_path / name).mkdir()
        write_cloud(tmp_path / name / "target.ply", target_m)
        write_cloud(tmp_path / name / "source.ply", transform_points(invert(truth), target_m))
    entries = [
        {
            "set": name,
            "source": f"{name}/source.ply",
            "target": f"{name}/target.ply",
            "T_target_source": truth.tolist(),
            "success_rotation_deg": 2.0,
            "success_translation_m": 0.1,
            "overlap": 0.7,
        }
        for name in ("hall", "attic")
    ]
    (tmp_path / "pairs.json").write_text(json.dumps({"pairs": entries}))
    return tmp_path


@pytest.mark.parametrize(
    ("turn", "shift_m"), [(False, 0.0), (True, 0.0), (True, 3.0), (False, 3.0)]
)
def test_truth_follows_the_moved_source(folder, truth, turn, shift_m):
    pair = FOLDER.pairs(folder, turn=turn, shift_m=shift_m, seed=5).load(0)
    aligned_m = transform_points(pair.T_target_source, pair.source_m)
    assert aligned_m == pytest.approx(pair.target_m, abs=1e-5)
    motion = invert(truth) @ pair.T_target_source
    assert np.linalg.norm(invert(motion)[:3, 3]) == pytest.approx(shift_m, abs=1e-9)
    assert (rotation_angle_rad(motion[:3, :3]) > 0.1) == turn


def test_turn_depends_on_seed_and_pair_alone(folder):
    everything = FOLDER.pairs(folder, seed=3)
    attic = FOLDER.pairs(folder, sets=["attic"], seed=3)
    np.testing.assert_array_equal(everything.load(1).source_m, attic.load(0).source_m)
    turns = [everything.load(0), everything.load(1), FOLDER.pairs(folder, seed=4).load(0)]
    assert len({pair.T_target_source.tobytes() for pair in turns}) == 3


def test_thresholds_and_names_come_from_the_file(folder):
    pairs = FOLDER.pairs(folder)
    assert pairs.names == ("hall/source-to-target", "attic/source-to-target")
    pair = pairs.load(1)
    assert (pair.set_name, pair.overlap, pair.success_translation_m) == ("attic", 0.7, 0.1)
    assert pair.success_rotation_rad == pytest.approx(np.deg2rad(2.0))
    assert pair.source_viewpoint_m is None


def test_simulated_pairs_are_named_by_their_seed():
    pairs = simulated_pairs("paper_room", 2, seed=7, points=500)
    assert pairs.names == ("paper_room_100007", "paper_room_100008")
    first, again = pairs.load(1), simulated_pairs("paper_room", 1, seed=8, points=500).load(0)
    assert first.name == again.name == "paper_room_100008"
    np.testing.assert_array_equal(first.source_m, again.source_m)


def test_missing_folder_says_which_option_names_it(tmp_path):
    with pytest.raises(FileNotFoundError, match="data=FOLDER"):
        FOLDER.pairs(tmp_path / "nowhere")


def test_unknown_set_lists_the_known_ones(folder):
    with pytest.raises(ValueError, match="sets=cellar: .*expected one of hall, attic"):
        FOLDER.pairs(folder, sets=["cellar"])


@pytest.mark.parametrize("text", ["not json", "[]", "{}", '{"pairs": []}', '{"pairs": 3}'])
def test_broken_pairs_file_is_refused(tmp_path, text):
    (tmp_path / "pairs.json").write_text(text)
    with pytest.raises(ValueError, match="pairs"):
        FOLDER.pairs(tmp_path)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("overlap", "much"),
        ("success_rotation_deg", "few"),
        ("T_target_source", [["a"]]),
        ("T_target_source", (2 * np.eye(4)).tolist()),
        ("T_target_source", np.full((4, 4), np.nan).tolist()),
        ("T_target_source", np.diag([-1.0, 1.0, 1.0, 1.0]).tolist()),
        ("source", None),
        ("set", ["hall"]),
    ],
)
def test_an_entry_that_makes_no_sense_is_refused_before_anything_runs(folder, field, value):
    path = folder / "pairs.json"
    listed = json.loads(path.read_text())
    listed["pairs"][1][field] = value
    path.write_text(json.dumps(listed))
    with pytest.raises(ValueError, match="pairs.json, entry 1: "):
        FOLDER.pairs(folder)


@pytest.mark.parametrize("entry", [{"set": "hall"}, "hall", None])
def test_what_is_no_entry_is_named_by_its_number(folder, entry):
    path = folder / "pairs.json"
    path.write_text(json.dumps({"pairs": [entry]}))
    with pytest.raises(ValueError, match="pairs.json, entry 0: "):
        FOLDER.pairs(folder)


def test_repeated_names_are_refused():
    with pytest.raises(ValueError, match="unique"):
        PairSet(("a", "b", "a"), load=lambda index: None)


def test_no_simulated_pairs_are_refused():
    with pytest.raises(ValueError, match="pairs=0"):
        simulated_pairs("paper_room", 0)


@pytest.mark.parametrize(
    "options", [{"family": "dorway"}, {"scanner": "kinect"}, {"rotation": "roll"}]
)
def test_unknown_choices_are_refused_before_any_pair_is_made(options):
    (name,) = options
    with pytest.raises(ValueError, match=f"{name}=.*expected one of"):
        simulated_pairs(**{"family": "doorway", "count": 1, **options})


def test_all_families_come_one_after_the_other():
    pairs = simulated_pairs("all", 1, points=500)
    assert {"paper_room_100000", "doorway_100000"} <= set(pairs.names)
    assert pairs.load(1).set_name == pairs.names[1].removesuffix("_100000")


# --- disturbances ---------------------------------------------------------------------------------


@pytest.fixture
def square(truth):
    """Two scans of the same flat square, 4 m wide."""
    target_m = np.random.default_rng(0).uniform([-2, -2, 0], [2, 2, 0.01], (20_000, 3))
    return Pair(
        "square", "toy", transform_points(invert(truth), target_m), target_m, truth, overlap=1.0
    )


def test_noise_shakes_every_coordinate_by_what_was_asked(square):
    shaken = disturb(square, DisturbanceConfig(noise_m=0.05))
    for before_m, after_m in (
        (square.source_m, shaken.source_m),
        (square.target_m, shaken.target_m),
    ):
        assert (after_m - before_m).std(axis=0) == pytest.approx([0.05] * 3, rel=0.05)
    assert shaken.overlap == 1.0


def test_thinning_keeps_a_share_of_the_points_where_they_are(square):
    thinned = disturb(square, DisturbanceConfig(keep=0.25))
    assert len(thinned.source_m) == pytest.approx(5000, rel=0.1)
    assert set(map(tuple, thinned.source_m)) <= set(map(tuple, square.source_m))


def test_cropping_cuts_both_scans_from_opposite_sides(square):
    """Each loses 30 %, so 40 % of the square is in both: 4 / 7 of what is left of the source."""
    cropped = disturb(square, DisturbanceConfig(crop=0.3))
    assert len(cropped.source_m) == len(cropped.target_m) == 14_000
    assert cropped.overlap is None
    assert measured_overlap(cropped, 0.1) == pytest.approx(4 / 7, abs=0.04)
    assert measured_overlap(square, 0.1) == 1.0


def test_every_pair_meets_every_condition_and_the_same_draws_each_time(folder):
    conditions = [DisturbanceConfig(), DisturbanceConfig("noisy", noise_m=0.1)]
    pairs = disturbed_pairs(FOLDER.pairs(folder), conditions)
    assert pairs.names[0] == "hall/source-to-target, as scanned"
    assert [pair.set_name for pair in pairs] == [
        "hall, as scanned", "attic, as scanned", "hall, noisy", "attic, noisy"
    ]  # fmt: skip
    np.testing.assert_array_equal(pairs.load(2).source_m, pairs.load(2).source_m)
    assert (pairs.load(2).source_m != pairs.load(0).source_m).any()
    assert disturbed_pairs(pairs, []) is pairs
