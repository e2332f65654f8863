"""Damaged files that once lied, hung, crashed or took all memory; each is refused in one line."""

from __future__ import annotations

import io
import os
import re
import resource
import struct
import zipfile

import numpy as np
import pytest

import skipnet
from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.panics import without_trace

PCD = "VERSION .7\nFIELDS x y z\nSIZE {size} 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\n"
PCD += "HEIGHT 1\nPOINTS {points}\nDATA {data}\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
MOST_BYTES = 200 << 20


@pytest.fixture
def refused(tmp_path):
    """Read a file and return the one line with which it is refused."""

    def read(name, content):
        path = tmp_path / name
        path.write_bytes(content)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(ValueError) as refusal:
            skipnet.read_cloud(path)
        taken = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) << 10
        message = str(refusal.value)
        assert message.startswith(str(path)) and "\n" not in message and len(message) < 500
        assert message.isprintable() and taken < MOST_BYTES
        return message

    return read


SIX = struct.pack("<6f", 1, 2, 3, 4, 5, 6)


def pcd(data="binary", points=2, size=4, body=SIX):
    return PCD.format(data=data, points=points, size=size).encode() + body


@pytest.mark.parametrize("data", ["asc", "", "binary_compresed", "binary x", "ascii_art"])
def test_pcd_of_an_unknown_encoding(refused, data):
    assert "unknown DATA" in refused("a.pcd", pcd(data))


@pytest.mark.parametrize("points", [3, 10**8, 2**63])
def test_pcd_that_holds_less_than_it_says(refused, points):
    assert "truncated" in refused("a.pcd", pcd(points=points))
    assert "truncated" in refused("a.pcd", pcd("ascii", points, body=b"1 2 3\n4 5 6\n"))


def test_pcd_whose_names_are_no_text(refused):
    content = pcd().replace(b"x y z", b"x y \x00\x1b\xfc" + b"z" * 1000)
    assert "lack x, y or z" in refused("a.pcd", content)


def test_pcd_of_absurd_sizes(refused):
    assert "whole numbers after SIZE" in refused("a.pcd", pcd(size=10_000_000))
    assert "TYPE and SIZE" in refused("a.pcd", pcd("binary_compressed", size=1000))


@pytest.mark.parametrize(
    "packed", [b"\x20\x05" * 8, b"\xff" * 20, bytes(3), b"\x17" + bytes(24) + b"\xe0\xff\xff"]
)
def test_pcd_of_damaged_compression(refused, packed):
    body = struct.pack("<II", len(packed), 24) + packed
    assert "damaged" in refused("a.pcd", pcd("binary_compressed", body=body))
    assert "damaged" in refused("a.pcd", pcd("binary_compressed", 10**7, body=body[:4]
                                             + struct.pack("<I", 12 * 10**7) + packed))  # fmt: skip


@pytest.mark.parametrize("line", ["", "#1 2 3"])
def test_ascii_ply_with_a_counted_line_that_is_no_point(refused, line):
    head = f"ply\nformat ascii 1.0\nelement vertex 3\n{XYZ}end_header\n"
    assert "damaged" in refused("a.ply", f"{head}1 2 3\n{line}\n4 5 6\n".encode())


def test_ply_of_absurd_lists(refused):
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {10**9}\n"
    head += f"property list uint float t\n{XYZ}end_header\n"
    assert "truncated" in refused("a.ply", head.encode() + b"\xff\xff\xff\x7f" + bytes(100))
    assert "truncated" in refused("b.ply", head.encode() + bytes(100))


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.xyz", "a.las", "a.e57", "a.obj", "a.bin"])
def test_bytes_of_nothing_are_refused_without_repeating_them(refused, name):
    assert name in refused(name, np.random.default_rng(0).bytes(601))


def las(tmp_path, extension, kind=6):
    laspy = pytest.importorskip("laspy")
    path = tmp_path / f"whole.{extension}"
    cloud = laspy.create(point_format=kind, file_version="1.4")
    cloud.x, cloud.y, cloud.z = np.random.default_rng(0).normal(size=(3, 50))
    cloud.write(path)
    return bytearray(path.read_bytes())


@pytest.mark.parametrize(
    ("at", "kind", "value"),
    [(100, "<I", 2**32 - 1), (243, "<I", 2**32 - 1), (247, "<Q", 10**8), (96, "<I", 2**31),
     (105, "<H", 65535), (105, "<H", 0)],
)  # fmt: skip
def test_las_headers_that_promise_too_much(refused, tmp_path, at, kind, value):
    content = las(tmp_path, "las")
    struct.pack_into(kind, content, at, value)
    assert "a.las" in refused("a.las", bytes(content))


def test_laz_with_false_chunks_and_layers(refused, tmp_path):
    content = las(tmp_path, "laz")
    (points_at,) = struct.unpack_from("<I", content, 96)
    (table_at,) = struct.unpack_from("<q", content, points_at)
    for at in (table_at + 4, points_at + 8 + 30 + 4):
        damaged = content.copy()
        struct.pack_into("<I", damaged, at, 2**32 - 1)
        assert "chunks" in refused("a.laz", bytes(damaged))
    for at in range(points_at + 8, len(content), 3):
        damaged = content.copy()
        damaged[at] ^= 0x55
        (tmp_path / "b.laz").write_bytes(bytes(damaged))
        try:
            assert len(skipnet.read_cloud(tmp_path / "b.laz")) <= 50
        except ValueError as error:
            assert str(error).startswith(str(tmp_path / "b.laz"))


def test_a_panic_of_the_decompressor_is_one_line_and_nothing_more(refused, tmp_path, capfd):
    content = las(tmp_path, "laz", kind=0)
    (points_at,) = struct.unpack_from("<I", content, 96)
    struct.pack_into("<H", content, points_at - 4, 1)  # bytes of what a point consists of
    assert "a.laz" in refused("a.laz", bytes(content))
    with without_trace():
        os.write(2, b"another thread's words")
    assert capfd.readouterr() == ("", "another thread's words")


def crc32c(content):
    """The checksum of E57's pages."""
    value = 0xFFFFFFFF
    for byte in content:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
    return struct.pack(">I", value ^ 0xFFFFFFFF)


def e57_with_xml(path, change):
    """An E57 file whose XML was changed, with right lengths and checksums."""
    skipnet.write_cloud(path, Cloud(np.random.default_rng(0).normal(size=(20, 3))))
    content = path.read_bytes()
    content = b"".join(content[at : at + 1020] for at in range(0, len(content), 1024))
    start = content.index(b"<?xml")
    (length,) = struct.unpack_from("<Q", content, 32)
    xml = change(content[start : start + length])
    content = content[:start] + xml
    content += bytes(-len(content) % 1020)
    pages = [content[at : at + 1020] for at in range(0, len(content), 1020)]
    head = bytearray(pages[0])
    struct.pack_into("<Q", head, 16, 1024 * len(pages))
    struct.pack_into("<Q", head, 32, len(xml))
    pages[0] = bytes(head)
    return b"".join(page + crc32c(page) for page in pages)


def test_e57_whose_count_is_false(refused, tmp_path):
    pytest.importorskip("pye57")
    for count in (b"21", b"100000000"):

        def change(xml, count=count):
            return re.sub(rb'recordCount="\d+"', b'recordCount="' + count + b'"', xml)

        content = e57_with_xml(tmp_path / "whole.e57", change)
        assert "holds 20" in refused("a.e57", content)


def test_e57_whose_xml_nests_deep(refused, tmp_path):
    pytest.importorskip("pye57")
    deep = b"<a>" * 5000 + b"</a>" * 5000
    content = e57_with_xml(
        tmp_path / "whole.e57", lambda xml: xml.replace(b"<guid", deep + b"<guid")
    )
    assert "nests" in refused("a.e57", content)


def archive(name, content, compression=zipfile.ZIP_DEFLATED):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", compression) as file:
        file.writestr(name, content)
    return packed.getvalue()


def npy(shape, body=b"", kind="<f8"):
    words = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(words)) + words.encode() + body


def test_numpy_files_of_false_sizes_and_other_contents(refused):
    assert "truncated" in refused("a.npy", npy((10**9, 3)))
    assert "truncated" in refused("a.npz", archive("points.npy", npy((10**9, 3))))
    assert "takes no room" in refused("f.npy", npy((2, 3), kind="<U0"))
    assert "no points" in refused("g.npy", npy((0, 10**14)))
    assert "columns" in refused("i.npy", npy((1, 10**5), bytes(8 * 10**5)))
    assert "no points" in refused("h.npz", archive("points.npy", npy((0, 10**14))))
    assert "(none)" in refused("b.npz", archive("points.txt", b"1 2 3"))
    assert "not a NumPy file" in refused("c.npz", archive("points.npy", b"no array"))
    bomb = npy((10**8, 3), bytes(24 * 10**6))
    refused("d.npz", archive("points.npy", bomb))
    buffer = io.BytesIO()
    np.save(buffer, np.array([[{}, 1, 2]], object), allow_pickle=True)
    assert "never read" in refused("e.npy", buffer.getvalue())


def test_text_of_false_counts(refused):
    assert "announces 3" in refused("a.pts", b"3\n1 2 3 0\n4 5 6 0\n")
    assert "announces" in refused("b.pts", b"99999999999999\n1 2 3 0\n")
    head = b"9\n9\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    turned, stretched = b"1 0 0 0\n0 1 0 0\n", b"2 0 0 0\n0 1 0 0\n"
    rest = b"0 0 1 0\n0 0 0 1\n1 2 3 0.5\n"
    assert "truncated" in refused("c.ptx", head + turned + rest)
    assert "no rigid motion" in refused("d.ptx", head + stretched + rest)
    assert "letters long" in refused("e.txt", b"1 2 3 " + b"7" * 100_000)
