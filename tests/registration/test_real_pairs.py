"""Real scans, each source turned by a random rotation first: the sets that register.py must manage.

The scans lie beside the project, not in it; without them these tests are skipped and say so.
"""

from pathlib import Path

import pytest

import skipnet
from skipnet.benchmark.datasets.listed import FOLDER as PAIRS
from skipnet.metrics.poses import score_pose

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "real"
SETS = ("libpm_tutorial", "jsanchez_room", "eth_tls_facade")

pytestmark = pytest.mark.skipif(
    not (FOLDER / "pairs.json").exists(), reason=f"no real scans in {FOLDER}"
)


@pytest.mark.parametrize("name", SETS)
def test_a_real_pair_comes_out_right_and_says_so(name):
    pair = next(iter(PAIRS.pairs(FOLDER, sets=[name], seed=7)))
    result = skipnet.register(pair.source_m, pair.target_m)
    assert score_pose(result.T_target_source, pair).success
    assert result.status == "registered", result.reason


def test_scans_of_different_places_are_not_registered():
    rooms = [next(iter(PAIRS.pairs(FOLDER, sets=[name], seed=7))) for name in SETS[:2]]
    result = skipnet.register(rooms[0].source_m, rooms[1].target_m)
    assert result.status != "registered", result.reason
