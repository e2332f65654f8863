"""Text files as scanners, surveyors and spreadsheets write them: sixty points of each kind."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet

N = 60
_rng = np.random.default_rng(3)
P = np.round(_rng.uniform(-5, 5, (N, 3)), 4)
RGB = _rng.integers(0, 256, (N, 3))
GREY = RGB[:, [0, 0, 0]]
INTENSITY = _rng.integers(-2048, 2048, N)
NORMALS = P / np.linalg.norm(P, axis=1, keepdims=True)
NUMBERS = np.arange(N)


def lines(*columns, mark=" ", head="", comma=False):
    """A line per point; whole columns without a point."""
    table = [
        [f"{value}" if array.dtype.kind in "iu" else f"{value:.6f}" for value in array]
        for column in columns
        for array in np.atleast_2d(np.asarray(column).T)
    ]
    text = "\n".join(mark.join(row) for row in zip(*table, strict=True)) + "\n"
    return head + (text.replace(".", ",") if comma else text)


def with_gap(gap, mark=","):
    """Lines of x, y, z, i of which one lacks its i."""
    rows = lines(P, NUMBERS * 0.5, mark=mark).splitlines()
    rows[7] = mark.join([*rows[7].split(mark)[:3], gap])
    return "\n".join(rows) + "\n"


KINDS = {
    "pts": f"{N}\n" + lines(P, INTENSITY, RGB),
    "pts grey": f"{N}\n" + lines(P, INTENSITY, GREY),
    "pts with a black picture": f"{N}\n" + lines(P, INTENSITY, 0 * RGB),
    "pts of bytes": f"{N}\n" + lines(P, RGB[:, 0], RGB),
    "colours as shares": lines(P, RGB / 255),
    "colours, intensity": lines(P, RGB, INTENSITY),
    "normals, colours": lines(P, NORMALS, RGB),
    "bars": lines(P, mark="|"),
    "blanks after commas": lines(P, mark=", "),
    "old Macintosh": lines(P).replace("\n", "\r"),
    "decimal commas and tabs": lines(P, mark="\t", comma=True),
    "decimal commas under a header": lines(P, mark="\t", comma=True, head="X\tY\tZ\n"),
    "decimal commas in quotes": "".join(
        ",".join(f'"{value:.4f}"'.replace(".", ",") for value in row) + "\n" for row in P
    ),
    "decimal commas, some whole": "".join(
        " ".join(f"{value:g}".replace(".", ",") for value in row) + "\n" for row in P
    ),
    "other order": lines(P[:, [1, 0, 2]], head="y x z\n"),
    "northing first": lines(P[:, [1, 0, 2]], mark=",", head="Northing,Easting,Elevation\n"),
    "German": lines(P, mark=";", comma=True, head="Rechtswert;Hochwert;Höhe\n"),
    "rows and columns named": lines(NUMBERS // 8, NUMBERS % 8, P, mark=",", head="row,col,x,y,z\n"),
    "rows and columns last": lines(P, RGB, NUMBERS // 8, NUMBERS % 8),
    "ROS": lines(NUMBERS, P, mark=",", head="%time,field.x,field.y,field.z\n"),
    "ParaView": lines(
        INTENSITY, P, mark=",", head='"intensity","Points:0","Points:1","Points:2"\n'
    ),
    "pandas": lines(NUMBERS, P, mark=",", head=",x,y,z\n"),
    "numbered columns": lines(P, mark=",", head="col1,col2,col3\n"),
    "a count below the names": lines(P, RGB, head=f"//X Y Z R G B\n{N}\n"),
    "words above the names": lines(P, head="Scanner: XY-100\nPoints: 60\nx y z\n"),
    "words above the points": lines(P, head="Scan export version 2.1\n"),
    "other comments": lines(P, head="; made by hand\n-- on a Monday\n"),
    "no number": "x,y,z,i\n" + with_gap(""),
    "NA": "x,y,z,i\n" + with_gap("NA"),
    "dashes": "x y z i\n" + with_gap("--", " "),
    "Fortran": "".join(" ".join(f"{v:.8E}".replace("E", "D") for v in row) + "\n" for row in P),
    "words with blanks": "name,x,y,z\n" + "".join(f'"my wall",{a},{b},{c}\n' for a, b, c in P),
    "packed colours": "x y z rgb\n" + "".join(f"{a} {b} {c} 16711808\n" for a, b, c in P),
    "mm in brackets": lines(1000 * P, mark=",", head="X[mm],Y[mm],Z[mm]\n"),
    "in mm": lines(1000 * P, mark=";", head="X in mm;Y in mm;Z in mm\n"),
    "per mm": lines(1000 * P, head="X/mm Y/mm Z/mm\n"),
    "units in a line of their own": lines(1000 * P, mark=",", head="x,y,z\nmm,mm,mm\n"),
    "units in a comment": lines(1000 * P, head="# units: millimeters\n# x y z\n"),
    "feet": lines(P / 0.3048, mark=",", head="X (feet),Y (feet),Z (feet)\n"),
}
COLOURS = {
    "pts": RGB, "pts grey": GREY, "pts with a black picture": 0 * RGB, "pts of bytes": RGB,
    "colours as shares": RGB, "colours, intensity": RGB, "normals, colours": RGB,
    "rows and columns last": RGB, "a count below the names": RGB,
    "packed colours": np.tile([255, 0, 128], (N, 1)),
}  # fmt: skip
INTENSITIES = {
    "pts": INTENSITY, "pts grey": INTENSITY, "pts with a black picture": INTENSITY,
    "pts of bytes": RGB[:, 0], "colours, intensity": INTENSITY, "ParaView": INTENSITY,
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_of_text(tmp_path, kind):
    path = tmp_path / ("a.pts" if kind.startswith("pts") else "a.txt")
    path.write_text(KINDS[kind], encoding="utf-8", newline="")
    cloud = skipnet.read_cloud(path)
    np.testing.assert_allclose(cloud.points_m, P, atol=1e-5)
    if kind in COLOURS:
        np.testing.assert_array_equal(cloud.colour, COLOURS[kind])
    if kind in INTENSITIES:
        np.testing.assert_array_equal(cloud.intensity, INTENSITIES[kind])


REFUSED = {
    "numbers of lines": (lines(NUMBERS, P), "counts the lines"),
    "rows and columns": (lines(NUMBERS // 8, NUMBERS % 8, P), "whole numbers alone"),
    "intensity first": (lines(INTENSITY, P), "whole numbers alone"),
    "time first": (lines(1.6e9 + 0.1 * NUMBERS, P), "as a time does"),
    "degrees": (lines(P, mark=",", head="lon,lat,height\n"), "project degrees"),
    "a share first": (lines((1 + P[:, :1]) % 1, P), "as an intensity does"),
    "degrees in a remark": (
        lines(P, P, head="# ID T LONGITUDE_A LATITUDE_A H_A COUNT\n"),
        "project degrees",
    ),
    "numbers of shots": (lines(0 * NUMBERS + 0.5, 1103940 + NUMBERS, P), "column 2 counts"),
    "other names": (lines(P, mark=",", head="mass,age,price\n"), "neither numbers nor x, y, z"),
    "a grid": ("ncols 3\nnrows 60\ncellsize 1\n" + lines(P), "grid of heights"),
    "too few points": (f"{N + 5}\n" + lines(P), "truncated"),
    "a word for a number": (lines(P) + "1 2 x\n", "row 60"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_makes_no_sense_is_refused(tmp_path, kind):
    text, words = REFUSED[kind]
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(ValueError, match=words):
        skipnet.read_cloud(tmp_path / "a.txt")


def test_a_row_without_a_place_is_dropped_and_said(tmp_path):
    rows = lines(P, mark=",").splitlines()
    rows[5] = ",,"
    (tmp_path / "a.csv").write_text("x,y,z\n" + "\n".join(rows))
    cloud = skipnet.read_cloud(tmp_path / "a.csv")
    np.testing.assert_allclose(cloud.points_m, np.delete(P, 5, axis=0), atol=1e-5)
    assert cloud.notes == ("dropped 1 of 60 rows without a finite place",)


def test_a_grid_of_map_coordinates_is_no_row_and_column(tmp_path):
    grid = np.array([[500000 + i, 5400000 + j, 300.5 + i / 7] for i in range(8) for j in range(8)])
    np.savetxt(tmp_path / "a.xyz", np.column_stack([grid, grid[:, 2]]), "%.3f")
    np.testing.assert_allclose(skipnet.read_points(tmp_path / "a.xyz"), grid, atol=1e-3)


def test_lines_above_the_points_are_said(tmp_path):
    (tmp_path / "a.txt").write_text(KINDS["words above the points"])
    note = "left out a line above the points, such as 'Scan export version 2.1'"
    assert skipnet.read_cloud(tmp_path / "a.txt").notes == (note,)


def ptx(scans, colours=True):
    """PTX text of (points, (4, 4) pose) of 10 x 6 beams each."""
    parts = []
    for points, T in scans:
        rows = [T[:3, 3], *T[:3, :3].T, *T.T]
        head = "\n".join(" ".join(f"{value:.9f}" for value in row) for row in rows)
        beams = [
            " ".join(f"{value:.6f}" for value in point)
            + (" 0.5 10 20 30" if colours and point.any() else " 0.5")
            for point in points
        ]
        parts.append("10\n6\n" + head + "\n" + "\n".join(beams) + "\n")
    return parts


@pytest.mark.parametrize("extension", ["ptx", "pts", "txt"])
@pytest.mark.parametrize("scale", [1.0, 0.3048])
def test_ptx_as_scanners_write_it(tmp_path, extension, scale):
    T = np.eye(4)
    T[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    T[:3, 3] = [3, 4, 1]
    scaled = T.copy()
    scaled[:3, :3] *= scale
    gaps = P.copy()
    gaps[::6] = 0  # without colours, as some programs write them
    met = gaps[gaps.any(axis=1)]
    expected = np.concatenate([met, scale * met @ T[:3, :3].T + T[:3, 3]])
    (tmp_path / f"a.{extension}").write_text("\n".join(ptx([(gaps, np.eye(4)), (gaps, scaled)])))
    cloud = skipnet.read_cloud(tmp_path / f"a.{extension}")
    np.testing.assert_allclose(cloud.points_m, expected, atol=1e-5)
    assert cloud.colour.tolist() == [[10, 20, 30]] * 100
