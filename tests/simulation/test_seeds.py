"""No scene that something was made from measures anything, and no user leaves its range."""

from __future__ import annotations

import ast
import json
from itertools import combinations
from pathlib import Path

import pytest

import skipnet
from skipnet.benchmark.datasets.overlapping import KINDS, overlapping_pairs
from skipnet.benchmark.datasets.simulated import simulated_pairs
from skipnet.registration.verdict import CALIBRATION_FILE
from skipnet.simulation import seeds
from skipnet.simulation.seeds import RANGES, SeedRange
from skipnet.studies import calibration, vigilance
from skipnet.training.data.options import DataConfig
from skipnet.training.descriptor_options import DescriptorTrainConfig
from skipnet.training.experiments import class_samples, lessons

SIMULATES = {
    "make_scene",
    "simulate_pair",
    "simulate_scans",
    "look_around",
    "turn_figure",
    "turn_sculpture",
    "glimpse",
}
"""What takes a scene's seed as its second argument, figures as their first."""


def test_no_two_ranges_share_a_seed():
    for one, other in combinations(RANGES, 2):
        assert one.stop <= other.first or other.stop <= one.first, (one.purpose, other.purpose)


def test_every_range_is_in_the_table_and_on_its_side():
    named = {value for value in vars(seeds).values() if isinstance(value, SeedRange)}
    assert named == set(RANGES) and len(named) == len(RANGES)
    made_from = RANGES[: RANGES.index(seeds.BENCHMARK)]
    assert all(one.stop <= seeds.FIRST_MEASURED for one in made_from)
    assert all(one.first >= seeds.FIRST_MEASURED for one in set(RANGES) - set(made_from))


def test_scenes_are_counted_from_the_first_and_stand_ins_stay_in_the_range():
    some = SeedRange("some", 500, 10, tries=3)
    assert list(some.take(3, skip=7)) == [507, 508, 509]
    assert list(some.stand_ins(7)) == [507, 517, 527]
    assert some.scene(0) == 500 and some.stop == 530
    assert 529 in some and 530 not in some and 499 not in some


@pytest.mark.parametrize(("count", "skip"), [(11, 0), (1, 10), (2, 9), (1, -1), (-1, 0)])
def test_what_lies_beyond_a_range_is_refused(count, skip):
    with pytest.raises(ValueError, match="some: .* numbered 0 to 9"):
        SeedRange("some", 500, 10).take(count, skip=skip)


def seed_of(name):
    return int(name.rsplit("_", 1)[1])


def test_benchmarks_stay_inside_their_ranges():
    simulated = simulated_pairs("all", 10_000)
    assert all(seed_of(name) in seeds.BENCHMARK for name in simulated.names)
    overlapping = overlapping_pairs(1000)
    assert all(seed_of(name) in seeds.OVERLAP for name in overlapping.names)
    assert len(overlapping) == 1000 * len(KINDS)
    with pytest.raises(ValueError, match="benchmark: 40 scenes from number 9980 on"):
        simulated_pairs("paper_room", 40, seed=9980)
    with pytest.raises(ValueError, match="overlap: 8 scenes"):
        overlapping_pairs(8, seed=1000)


def test_studies_stay_inside_their_ranges():
    apart = [case for case in vigilance.cases(1000, 8999) if case.group.startswith("negatives")]
    assert all(
        seed in seeds.VIGILANCE_APART for c in apart for seed in (c.source_seed, c.target_seed)
    )
    with pytest.raises(ValueError, match="vigilance"):
        vigilance.cases(1001, 0)
    with pytest.raises(ValueError, match="vigilance"):
        vigilance.cases(1, 9000)
    assert calibration.jobs(500)
    with pytest.raises(ValueError, match="calibration"):
        calibration.jobs(501)


def test_training_stays_inside_its_ranges():
    most = DataConfig(training_scenes=1000, validation_scenes=1000, test_scenes=1000)
    for name, expected in class_samples.SEEDS.items():
        assert all(seed in expected for seed in class_samples.class_seeds(most, name))
    options = DescriptorTrainConfig(training_pairs=1000, validation_pairs=1000, test_pairs=1000)
    for name, expected in lessons.SEEDS.items():
        assert all(seed in expected for seed in lessons._seeds(options, name))


def test_the_shipped_confidence_was_fitted_in_its_range():
    fit = json.loads(Path(CALIBRATION_FILE).read_text())
    assert fit["first_seed"] == seeds.CALIBRATION.first


def test_no_scene_is_made_from_a_number_that_stands_in_the_code():
    """Every seed in the package comes from the table, through a variable."""
    found = []
    for path in Path(skipnet.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and name_of(node.func) in SIMULATES:
                given = [*node.args, *(keyword.value for keyword in node.keywords)]
                if any(isinstance(v, ast.Constant) and type(v.value) is int for v in given[:2]):
                    found.append(f"{path}:{node.lineno}")
    assert found == []


def name_of(function):
    return getattr(function, "id", getattr(function, "attr", ""))
