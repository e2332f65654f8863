"""Colours of sixteen bits, columns that only some pieces of a file use, and what a format has no
room for."""

from __future__ import annotations

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud, concatenate
from skipnet.clouds.formats import las as las_format
from skipnet.clouds.formats.reading import read_chunks

COUNT = 300
RNG = np.random.default_rng(4)
POINTS_M = np.round(RNG.uniform(-5, 5, (COUNT, 3)), 3)
FINE = RNG.integers(0, 65536, (COUNT, 3)).astype(np.uint16)


def las_of(path, colour, **dimensions):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=7, file_version="1.4")
    las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = POINTS_M.T
    las.red, las.green, las.blue = colour.T
    for name, values in dimensions.items():
        las[name] = values
    las.write(path)


@pytest.mark.parametrize("extension", ["las", "laz", "ply", "pcd", "e57", "csv", "xyz", "npz"])
def test_colours_of_16_bits_come_back(tmp_path, extension):
    pytest.importorskip("pye57" if extension == "e57" else "laspy")
    las_of(tmp_path / "a.las", FINE)
    cloud = skipnet.read_cloud(tmp_path / "a.las")
    np.testing.assert_array_equal(cloud.colour, FINE)
    skipnet.write_cloud(tmp_path / f"b.{extension}", cloud)
    again = skipnet.read_cloud(tmp_path / f"b.{extension}")
    assert again.colour.dtype == np.uint16
    np.testing.assert_array_equal(again.colour, FINE)
    np.testing.assert_array_equal(again.colour_8bit, FINE >> 8)


@pytest.mark.parametrize("extension", ["ply", "pcd"])
def test_open3d_reads_the_upper_8_bits(tmp_path, extension):
    o3d = pytest.importorskip("open3d")
    path = tmp_path / f"a.{extension}"
    skipnet.write_cloud(path, Cloud(POINTS_M, colour=FINE))
    colours = np.asarray(o3d.io.read_point_cloud(str(path)).colors)
    np.testing.assert_array_equal(np.rint(colours * 255), FINE >> 8)


def test_laspy_reads_the_16_bits(tmp_path):
    laspy = pytest.importorskip("laspy")
    cloud = Cloud(POINTS_M, colour=FINE)
    skipnet.write_cloud(tmp_path / "a.laz", cloud)
    read = laspy.read(tmp_path / "a.laz")
    np.testing.assert_array_equal(np.stack([read.red, read.green, read.blue], 1), FINE)


@pytest.mark.parametrize("step", [1, 256, 257])
def test_16_bits_that_hold_8_are_8(tmp_path, step):
    coarse = FINE >> 8
    las_of(tmp_path / "a.las", coarse * step)
    colour = skipnet.read_cloud(tmp_path / "a.las").colour
    assert colour.dtype == np.uint8
    np.testing.assert_array_equal(colour, coarse)
    skipnet.write_cloud(tmp_path / "a.ply", Cloud(POINTS_M, colour=coarse * np.uint16(step)))
    assert b"property uchar red" in (tmp_path / "a.ply").read_bytes()[:400]


def test_scans_of_8_and_16_bits_are_merged_as_16():
    eight, sixteen = Cloud(POINTS_M, colour=(FINE >> 8).astype(np.uint8)), Cloud(POINTS_M, FINE)
    merged = concatenate([eight, sixteen])
    np.testing.assert_array_equal(merged.colour, np.concatenate([(FINE >> 8) * 257, FINE]))


@pytest.mark.parametrize("extension", ["las", "laz"])
def test_what_only_some_pieces_of_a_file_use_is_kept(tmp_path, monkeypatch, extension):
    """Of a scan whose first half has no colours, no classes and no intensities, nothing is lost."""
    monkeypatch.setattr(las_format, "RECORDS_AT_ONCE", 100)
    late = np.arange(COUNT) >= 150
    classes, intensity = 2 * late, 300 * late
    path = tmp_path / f"a.{extension}"
    las_of(path, FINE * late[:, None], classification=classes, intensity=intensity)
    cloud = skipnet.read_cloud(path)
    assert cloud.holds == ["colour", "intensity", "classification"]
    np.testing.assert_array_equal(cloud.columns["classification"], classes)
    np.testing.assert_array_equal(cloud.colour, FINE * late[:, None])
    skipnet.write_cloud(tmp_path / "b.ply", read_chunks(path))  # as large files are written
    again = skipnet.read_cloud(tmp_path / "b.ply")
    np.testing.assert_array_equal(again.columns["classification"], classes)
    np.testing.assert_array_equal(again.intensity, intensity)
    np.testing.assert_array_equal(again.colour, cloud.colour)


COLUMNS = {
    "label": RNG.integers(-3, 9, COUNT),
    "Scalar field #2": RNG.normal(size=COUNT),
    "flag": RNG.random(COUNT) > 0.5,
}


def test_e57_takes_columns_that_the_standard_has_no_name_for(tmp_path):
    pye57 = pytest.importorskip("pye57")
    intensity = RNG.random(COUNT)
    skipnet.write_cloud(tmp_path / "a.e57", Cloud(POINTS_M, None, intensity, columns=COLUMNS))
    found = skipnet.read_cloud(tmp_path / "a.e57").columns
    assert list(found) == ["label", "Scalar_field__2", "flag"]
    for values, again in zip(COLUMNS.values(), found.values(), strict=True):
        np.testing.assert_array_equal(again, values)
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        scan = file.read_scan(0, intensity=True, ignore_missing_fields=True)
    np.testing.assert_allclose(scan["intensity"], intensity, rtol=1e-6)


@pytest.mark.parametrize("extension", ["ply", "pcd", "npz", "las", "csv"])
def test_names_of_columns_keep_their_letters(tmp_path, extension):
    skipnet.write_cloud(
        tmp_path / f"a.{extension}", Cloud(POINTS_M, columns={"Höhe_2": FINE[:, 0]})
    )
    assert list(skipnet.read_cloud(tmp_path / f"a.{extension}").columns) == ["Höhe_2"]


@pytest.mark.parametrize("extension", ["ply", "csv", "xyz", "las", "e57"])
def test_the_unit_of_a_file_is_known_again(tmp_path, extension):
    pytest.importorskip("pye57")
    skipnet.write_cloud(tmp_path / f"a.{extension}", Cloud(POINTS_M, unit="ft", crs=FEET))
    cloud = skipnet.read_cloud(tmp_path / f"a.{extension}")
    np.testing.assert_allclose(cloud.points_m, POINTS_M, atol=1e-4)


FEET = 'LOCAL_CS["site",UNIT["foot",0.3048]]'


@pytest.mark.parametrize(
    ("extension", "said"),
    [
        ("npy", "colour, label, Scalar field #2, flag"),
        ("xyz", "its coordinate system, the sensor's place"),
        ("pcd", "its coordinate system"),
        ("ply", None), ("las", None), ("e57", None), ("npz", None),
    ],
)  # fmt: skip
def test_what_a_format_has_no_room_for_is_said(tmp_path, caplog, extension, said):
    pytest.importorskip("pye57")
    cloud = Cloud(POINTS_M, FINE, columns=COLUMNS, viewpoint_m=np.ones(3), crs="EPSG:25832")
    skipnet.write_cloud(tmp_path / f"a.{extension}", cloud)
    messages = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert messages == ([f"{tmp_path / f'a.{extension}'}: written without {said}"] if said else [])
