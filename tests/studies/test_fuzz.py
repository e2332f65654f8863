"""The study of damaged files finds what is planted; a number names a file."""

from __future__ import annotations

import json
import os
import struct
import zlib

import numpy as np

from skipnet.clouds.formats.reading import SUPPORTED
from skipnet.commands.study import main
from skipnet.studies import fuzz
from skipnet.studies.corpus import corpus
from skipnet.studies.mutations import mutated


def test_the_study_runs_and_tells_how_many(tmp_path):
    out = tmp_path / "out"
    assert main(["fuzz", "formats=[npy,bin]", "files=40", "workers=1", f"output_dir={out}"]) == 0
    assert "| .npy | 40 |" in (out / "report.md").read_text()
    assert json.loads((out / "summary.json").read_text())["findings"] == []
    assert main(["fuzz", "formats=[nyp]", f"output_dir={tmp_path / 'no'}"]) == 2


def test_what_a_reader_does_wrong_is_a_finding(tmp_path, monkeypatch):
    path = tmp_path / "a.xyz"

    def reader(does):
        monkeypatch.setattr(fuzz, "read_cloud", does)
        return fuzz.outcome_of(path)[0]

    def raises(error):
        def does(_):
            raise error

        return does

    assert reader(raises(ValueError(f"{path}: damaged"))) == "refused"
    assert reader(raises(ValueError("damaged"))) == "unclear line"
    assert reader(raises(ValueError(f"{path}: two\nlines"))) == "unclear line"
    assert reader(raises(KeyError("x"))) == reader(raises(MemoryError())) == "raises"
    cloud = type("Cloud", (), {"points_m": np.full((1, 3), np.nan), "__len__": lambda self: 1})
    assert reader(lambda _: cloud()) == "no points"


def worse(files, extension, seed, number):
    """One file ends the process that reads it, another lets it say something."""
    if number == 2:
        os.abort()
    if number == 4:
        os.write(2, b"words")
    return mutated(files, extension, seed, number)


def test_crashes_and_words_on_the_terminal_are_found_and_the_rest_goes_on():
    outcome = fuzz.do(fuzz.Job(".bin", 0, 0, 6, worse))
    kinds = [(found["file"], found["kind"]) for found in outcome["findings"]]
    assert kinds == [("bin/0/2", "crashes"), ("bin/0/4", "prints")]
    assert outcome["read"] + outcome["refused"] == 4


def test_every_format_has_whole_files_and_a_number_names_a_file():
    for extension in SUPPORTED:
        files = corpus(extension)
        assert files and all(files)
        once, again, other = (mutated(files, extension, 0, number) for number in (7, 7, 8))
        assert once == again and once != other


def test_what_is_changed_behind_checksums_has_right_ones():
    files = corpus(".png")
    kept = [mutated(files, ".png", 0, number) for number in range(20)]
    sound = 0
    for content in kept:
        (length,) = struct.unpack_from(">I", content, 8)
        body = content[12 : 16 + length]
        sound += content[16 + length : 20 + length] == struct.pack(">I", zlib.crc32(body))
    assert sound > 8
