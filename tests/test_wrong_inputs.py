"""What people hand over by mistake: a sentence that says what was expected, no bare error."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet import Cloud, Prior, RegistrationConfig

POINTS_M = np.random.default_rng(0).uniform(-3, 3, (300, 3))
COLUMN = np.arange(300)
CASES = {
    "final_samples": (lambda: RegistrationConfig(final_samples="many"), "whole number of 50"),
    "sigma": (lambda: RegistrationConfig(denoise_sigma="1"), "a number of 0 or more"),
    "neighbours": (lambda: RegistrationConfig(denoise_neighbours=1.5), "whole number of 1"),
    "generators": (lambda: RegistrationConfig(generators=7), "members of Generator"),
    "network in config": (lambda: RegistrationConfig(network=3), "network=3: expected a name"),
    "no network": (lambda: skipnet.load_network(None), "network=None: expected a name"),
    "read nothing": (lambda: skipnet.read_cloud(None), "path=None: expected a path"),
    "read many": (lambda: skipnet.read_points(["a", "b"]), "expected a path"),
    "unit of nothing": (lambda: skipnet.read_cloud(__file__, unit=None), "expected one of m, mm"),
    "write nowhere": (lambda: skipnet.write_cloud(None, POINTS_M), "path=None: expected a path"),
    "write nothing": (lambda: skipnet.write_cloud("a.ply", None), "expected numbers of shape"),
    "write words": (lambda: skipnet.write_cloud("a.ply", "abc"), "expected numbers of shape"),
    "write a dict": (lambda: skipnet.write_cloud("a.ply", {"a": 1}), "expected numbers of shape"),
    "cloud of nothing": (lambda: Cloud(None), r"got object of shape \(\): expected numbers"),
    "ragged cloud": (lambda: Cloud([[1, 2, 3], [4, 5]]), "cloud: expected numbers"),
    "truths": (lambda: Cloud(POINTS_M > 0), "got bool"),
    "few colours": (lambda: Cloud(POINTS_M, np.zeros((5, 3), np.uint8)), r"shape \(300, 3\)"),
    "shares": (lambda: Cloud(POINTS_M, POINTS_M), "expected whole numbers, 0 to 255 or 65535"),
    "short column": (lambda: Cloud(POINTS_M, columns={"a": [1, 2]}), r"column a: .*\(300,\)"),
    "words": (lambda: Cloud(POINTS_M, columns={"a": ["x"] * 300}), "column a: .*numbers"),
    "cloud in parsecs": (lambda: Cloud(POINTS_M, unit="parsec"), "expected one of m, mm"),
    "one row": (lambda: Cloud(POINTS_M)[3], r"expected numbers of shape \(N, 3\)"),
    "a turn": (lambda: Cloud(POINTS_M).moved(np.eye(3)), r"expected a pose \(4, 4\)"),
    "deviation": (lambda: Prior(np.eye(4), position_std_m="far"), "0 or more, or None"),
    "no scans": (lambda: skipnet.register_many(None), "expected two or more in a list"),
    "five": (lambda: skipnet.register_many(5), "expected two or more in a list"),
    "one generator": (lambda: skipnet.register_many(s for s in [POINTS_M]), "got 1 scans"),
    "folder": (lambda: skipnet.Project(3), "folder=3: expected a path"),
    "workers": (lambda: skipnet.Project(workers=3), "workers=3: expected"),
    "map of nothing": (lambda: skipnet.build_skipmap(None, 0.1), r"expected numbers of shape"),
    "map of a name": (lambda: skipnet.build_skipmap("a.ply", 0.1), r"expected numbers of shape"),
    "seed": (lambda: skipnet.register(POINTS_M, POINTS_M, seed=None), "whole number"),
    "config": (lambda: skipnet.register(POINTS_M, POINTS_M, config={}), "a RegistrationConfig"),
    "prior": (lambda: skipnet.register(POINTS_M, POINTS_M, prior="here"), r"pose \(4, 4\)"),
    "dict of points": (lambda: skipnet.register({"points": POINTS_M}, POINTS_M), "source: got"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_mistake_is_answered_by_a_sentence(case):
    make, said = CASES[case]
    with pytest.raises(ValueError, match=said):
        make()


def test_lists_are_as_good_as_arrays_and_a_cloud_is_an_array():
    cloud = Cloud(POINTS_M.tolist(), [[1, 2, 300]] * 300, columns={"label": COLUMN.tolist()})
    assert cloud.colour.dtype == np.uint16 and cloud.columns["label"][7] == 7
    np.testing.assert_array_equal(np.asarray(cloud), POINTS_M)
    assert len(skipnet.build_skipmap(cloud, 1.0)) == len(skipnet.build_skipmap(POINTS_M, 1.0))
