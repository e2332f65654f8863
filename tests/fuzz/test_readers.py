"""Files of every format with bytes changed: read in full or refused in one line, nothing else."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skipnet.clouds.cloud import Cloud
from skipnet.clouds.formats.reading import SUPPORTED, read_cloud
from skipnet.clouds.formats.writing import WRITABLE, write_cloud

EXAMPLES = 200
MOST_POINTS = 200_000
"""Of a mesh's samples; no other file here has more than some hundred."""
WORDS = [b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f", b"\xff" * 8, b"-1", b"99999999999", b"nan"]
WORDS += [b"1e400", b"\n", b" ", b"#", b",", b"0", b"x"]
PTX = (
    b"2\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n3 0 0 1\n1 0 0 0.5\n0 1 0 0.5\n"
)
NEEDED = {".las": "laspy", ".laz": "laspy", ".e57": "pye57"}
NEEDED |= dict.fromkeys((".obj", ".stl", ".glb", ".off"), "trimesh")


def whole_file(extension, path):
    """A small file of a format, written by a library that knows it, or by us."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-5, 5, (30, 3))
    if extension in NEEDED:
        pytest.importorskip(NEEDED[extension])
    if extension in WRITABLE:
        write_cloud(path, Cloud(points, colour=rng.integers(0, 255, (30, 3)).astype(np.uint8)))
    elif extension == ".bin":
        points.astype("<f4")[:28].tofile(path)
    elif extension == ".pts":
        path.write_text("2\n1 2 3 4 5 6 7\n4 5.5 6 7 8 9 1\n")
    elif extension == ".png":
        from PIL import Image

        Image.fromarray(np.arange(30, dtype=np.uint16).reshape(5, 6)).save(path)
        path.with_suffix(".json").write_text('{"fx": 5, "fy": 5, "cx": 3, "cy": 2}')
    elif extension == ".ptx":
        path.write_bytes(2 * PTX)
    else:
        import trimesh

        trimesh.creation.box().export(path)
    return path.read_bytes()


changes = st.lists(
    st.tuples(
        st.sampled_from(["replace", "insert", "delete", "cut"]),
        st.floats(0, 1, exclude_max=True).map(lambda share: share**2),  # headers more often
        st.one_of(st.binary(min_size=1, max_size=4), st.sampled_from(WORDS)),
    ),
    min_size=1,
    max_size=4,
)


def changed(content, how):
    for kind, share, piece in how:
        at = int(share * len(content))
        ends = {"replace": at + len(piece), "insert": at, "delete": at + 3 * len(piece)}
        content = content[:at] + (
            b"" if kind == "cut" else (b"" if kind == "delete" else piece) + content[ends[kind] :]
        )
    return content


@pytest.mark.parametrize("extension", SUPPORTED)
def test_a_changed_file_is_read_or_refused(extension, tmp_path):
    path = tmp_path / f"scan{extension}"
    whole = whole_file(extension, path)

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(changes)
    def read(how):
        path.write_bytes(changed(whole, how))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                cloud = read_cloud(path)
        except ValueError as error:
            message = str(error)
            assert str(path) in message and "\n" not in message and len(message) < 500
        else:
            assert 0 < len(cloud) <= MOST_POINTS and np.isfinite(cloud.points_m).all()

    read()
