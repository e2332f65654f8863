"""Files of every format with bytes changed: read in full or refused in one line, nothing else."""

from __future__ import annotations

import warnings

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skipnet.clouds.formats.reading import SUPPORTED
from skipnet.studies.corpus import corpus
from skipnet.studies.fuzz import SLOW, outcome_of
from skipnet.studies.mutations import mutated

WORDS = [b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f", b"\xff" * 8, b"-1", b"99999999999", b"nan"]
WORDS += [b"1e400", b"\n", b" ", b"#", b",", b"0", b"x"]
NEEDED = {".las": "laspy", ".laz": "laspy", ".e57": "pye57"}
NEEDED |= dict.fromkeys((".obj", ".stl", ".glb", ".off"), "trimesh")
EXAMPLES = {extension: 60 if extension in SLOW else 150 for extension in SUPPORTED}


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


@pytest.fixture(params=SUPPORTED)
def files(request, tmp_path):
    """The place of a file, and whole contents of a format by the libraries that know it."""
    if request.param in NEEDED:
        pytest.importorskip(NEEDED[request.param])
    path = tmp_path / f"scan{request.param}"
    path.with_suffix(".json").write_text('{"fx": 5, "fy": 5, "cx": 3, "cy": 2}')
    return path, corpus(request.param)


def test_a_changed_file_is_read_or_refused(files):
    path, whole = files

    @settings(
        max_examples=EXAMPLES[path.suffix],
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(whole), changes)
    def read(content, how):
        path.write_bytes(changed(content, how))
        assert outcome_of(path)[0] in ("read", "refused"), outcome_of(path)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for content in whole:
            path.write_bytes(content)
            assert outcome_of(path) == ("read", "")
        read()


def test_what_lies_behind_checksums_is_read_or_refused(files):
    path, whole = files
    for number in range(EXAMPLES[path.suffix] // 2):
        path.write_bytes(mutated(whole, path.suffix, seed=99, number=number))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind, told = outcome_of(path)
        assert kind in ("read", "refused"), (number, told)
