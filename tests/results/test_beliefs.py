"""Files of what is believed of many scans."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.results.beliefs import read_priors

NAMES = ["scans/a.ply", "scans/b.ply", "scans/c.ply"]
GIVEN = """
positions_m:
  a.ply: [0, 0, 1.5]
  1: [4, 0, 1.5]
position_std_m: 2
poses:
  c.ply: {T: [[1,0,0,5],[0,1,0,0],[0,0,1,0],[0,0,0,1]], rotation_std_deg: 5}
links:
  - {target: a.ply, source: b.ply}
  - {target: c.ply, source: a.ply, T_target_source: [[1,0,0,0],[0,1,0,2],[0,0,1,0],[0,0,0,1]]}
non_links:
  - [a.ply, c.ply]
"""


def test_a_yaml_file_gives_all_kinds_of_priors(tmp_path):
    file = tmp_path / "priors.yaml"
    file.write_text(GIVEN)
    priors = read_priors(file, NAMES)
    assert dict(priors.positions_m) == {0: [0, 0, 1.5], 1: [4, 0, 1.5]}
    assert priors.position_std_m == 2
    assert priors.poses[2].rotation_std_deg == 5 and priors.poses[2].position_std_m is None
    assert list(priors.links) == [(0, 1), (2, 0)] and priors.links[0, 1] is None
    T = np.asarray(priors.guesses(reach_m=1.0)[0, 2].T_target_source)
    np.testing.assert_allclose(T[:3, 3], [0, -2, 0])  # of the second in the first
    assert priors.non_links == [(0, 2)]


def test_a_csv_file_gives_positions(tmp_path):
    file = tmp_path / "gnss.csv"
    file.write_text("scan, x_m, y_m, z_m\nb.ply, 1, 2, 3\na.ply, 0.5, 0, 0\n")
    assert dict(read_priors(file, NAMES).positions_m) == {1: [1, 2, 3], 0: [0.5, 0, 0]}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("positions_m: {d.ply: [0,0,0]}", "no scan is called 'd.ply'"),
        ("position: {a.ply: [0,0,0]}", "unknown part 'position'"),
        ("positions_m: {a.ply: [0,0]}", "expected three finite numbers"),
        ("links: [{target: a.ply}]", "'source'"),
        ("- 1", "expected some of positions_m"),
        ("{", "is no YAML"),
        ("poses: {a.ply: {T: [[1]]}}", r"expected a finite pose \(4, 4\)"),
    ],
)
def test_what_is_no_prior_is_refused_in_one_line(tmp_path, text, said):
    file = tmp_path / "p.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=said) as raised:
        read_priors(file, NAMES)
    assert str(raised.value).startswith(str(file)) and "\n" not in str(raised.value)
    with pytest.raises(ValueError, match="expected the columns scan, x_m"):
        other = tmp_path / "p.csv"
        other.write_text("a,b\n1,2\n")
        read_priors(other, NAMES)
    with pytest.raises(FileNotFoundError, match="no such file with priors"):
        read_priors(tmp_path / "none.yaml", NAMES)
