"""What a command tells: a bar on a terminal alone, quiet and JSON modes, one table of a sweep."""

from __future__ import annotations

import io
import json
import sys
import time
from dataclasses import dataclass

import numpy as np
import pytest

from skipnet import progress
from skipnet.commands.sweeps import note_run, sweep_table
from skipnet.progress import Terminal, counted, in_words, listening, say, shown, tell


class Screen(io.StringIO):
    """A terminal."""

    def isatty(self):
        return True


def test_a_bar_appears_on_a_terminal_when_it_takes_long(monkeypatch):
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    monkeypatch.setattr(progress, "_REDRAWN_S", 0.01)
    with shown("register"):
        tell("pairs", 3, 12)
        tell("fine alignment")
        while "fine alignment" not in screen.getvalue():
            time.sleep(0.01)
        say("half way")
    assert "pairs 3/12 fine alignment" in screen.getvalue()
    assert "half way\n" in screen.getvalue() and screen.getvalue().endswith("half way\n")


def test_elsewhere_there_is_no_bar(monkeypatch, capsys):
    monkeypatch.setattr(progress, "_PATIENCE_S", 0.0)
    with shown("register"):
        tell("pairs", 3, 12)
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("terminal", [Terminal.quiet, Terminal.json])
def test_in_silence_nothing_is_told(terminal, capsys):
    with shown("register", terminal):
        print("a word")
        say("another")
    assert capsys.readouterr() == ("", "")


def test_listeners_hear_stages_while_they_listen():
    heard = []
    with listening(lambda *words: heard.append(words)):
        tell("pairs", 1, 2)
    tell("later")
    assert heard == [("pairs", 1, 2)]


def test_what_is_counted_is_told_from_its_start():
    heard = []
    with listening(lambda *words: heard.append(words)):
        assert list(counted("scenes", "ab", 2)) == ["a", "b"]
    assert heard == [("scenes", 0, 2), ("scenes", 1, 2), ("scenes", 2, 2)]


def test_times_are_never_sixty_seconds():
    assert [in_words(time_s) for time_s in (0.4, 99.4, 99.6, 779.7)] == [
        "0 s", "99 s", "1 min 40 s", "13 min 00 s"
    ]  # fmt: skip


def test_json_is_one_line_with_the_fields_of_the_result(tmp_path, capsys, monkeypatch):
    from skipnet.commands.register import main

    rng = np.random.default_rng(0)
    for name in "ab":
        np.save(tmp_path / f"{name}.npy", rng.normal(size=(3000, 3)))
    monkeypatch.chdir(tmp_path)
    code = main(["source=a.npy", "target=b.npy", "output_dir=out", "terminal=json"])
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert code == 3 and err == "" and out.count("\n") == 1
    assert found["status"] != "registered" and np.shape(found["T_target_source"]) == (4, 4)


def test_a_sweep_ends_in_one_table_of_what_differs(tmp_path):
    for number, voxel in enumerate(("0.1", "0.2")):
        rows = [{"method": "skipnet", "median error (mm)": 1.5 + number}]
        note_run(tmp_path / str(number), [f"voxel={voxel}", "pairs=3"], rows)
    text = sweep_table(tmp_path)
    assert text == (tmp_path / "sweep.md").read_text()
    assert "| run | voxel | method | median error (mm) |" in text
    assert "| 0 | 0.1 | skipnet | 1.50 |" in text and "pairs" not in text


@dataclass
class Point:
    """An entry point."""

    name: str
    value: str


def test_methods_from_outside_take_part_by_file_and_by_entry_point(tmp_path, monkeypatch):
    from skipnet.benchmark import options
    from skipnet.benchmark.methods import make_method

    (tmp_path / "elsewhere.py").write_text("def make():\n    return lambda task: 'answer'\n")
    by_file = f"{tmp_path}/elsewhere.py:make"
    found = [Point("theirs", "their_package.methods:make")]
    monkeypatch.setattr(options, "entry_points", lambda group: found)
    config = options.EvaluateConfig(outside=["theirs", by_file])
    made = {name: method.make for name, method in config.methods.items()}
    assert made == {"theirs": "their_package.methods.make", "elsewhere": by_file}
    assert make_method(by_file)(None) == "answer"
    assert "elsewhere" not in sys.modules
    with pytest.raises(ValueError, match="did you mean theirs"):
        options.EvaluateConfig(outside=["their"])
    with pytest.raises(FileNotFoundError, match=r"none.py: no such file"):
        make_method("none.py:make")
