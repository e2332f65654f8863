"""A run owns its folder; its results replace an earlier run's as a whole, or leave them alone."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from skipnet.results.folder import new_results
from skipnet.storage import MARK, append_line, owned, replacing, write_text


def write(folder, by="register", **contents):
    with owned(folder, by), new_results(folder) as staging:
        for stem, text in contents.items():
            (staging / f"{stem}.json").write_text(text)


def names(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != MARK)


def test_results_of_another_kind_go_and_it_is_said(tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    write(out, result="a pair")
    (out / "notes.txt").write_text("the user's")
    (out / "aligned.laz").write_text("old")
    assert capsys.readouterr().out == ""
    write(out, poses="many")
    assert names(out) == ["notes.txt", "poses.json"]
    assert "earlier run will be replaced: aligned.laz, result.json" in capsys.readouterr().out
    assert names(out.parent) == ["out"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_after_an_error_all_is_as_it_was(tmp_path, error):
    out = tmp_path / "out"
    write(out, result="before")
    with pytest.raises(type(error)) as told, new_results(out) as staging:
        (staging / "result.json").write_text("half")
        raise error
    assert (out / "result.json").read_text() == "before" and names(out) == ["result.json"]
    with (
        pytest.raises(type(error)),
        owned(tmp_path / "a" / "b", "x"),
        new_results(tmp_path / "a" / "b"),
    ):
        raise error
    assert names(tmp_path) == ["out"]
    assert not isinstance(error, OSError) or str(out) in str(told.value)


@pytest.mark.parametrize("error", [(28, "No space left on device"), ("5 requested, 3 written",)])
def test_what_could_not_be_written_is_named_as_it_would_be_called(tmp_path, error):
    with (
        pytest.raises(OSError) as told,
        new_results(tmp_path) as staging,
        replacing(staging / "aligned.ply"),
    ):
        raise OSError(*error)
    assert error[-1] in str(told.value)
    assert told.value.filename == str(tmp_path / "aligned.ply") and names(tmp_path) == []


def test_runs_at_the_same_time_do_not_mix(tmp_path):
    out, refused = tmp_path / "out", []

    def run(text):
        try:
            write(out, result=text, poses=text)
        except ValueError as error:
            refused.append(str(error))

    threads = [threading.Thread(target=run, args=(str(k),)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (out / "result.json").read_text() == (out / "poses.json").read_text()
    assert names(out) == ["poses.json", "result.json"] and names(tmp_path) == ["out"]
    assert all("another run writes into it now" in line for line in refused)


def test_a_run_has_its_folder_to_itself_until_it_ends_however(tmp_path):
    code = "import sys, pathlib; from skipnet.storage import owned\n"
    code += "with owned(pathlib.Path(sys.argv[1]), 'train'): print('has it', flush=True); input()"
    holder = subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "out"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert holder.stdout.readline() == b"has it\n"
    with pytest.raises(ValueError, match="another run"), owned(tmp_path / "out", "train"):
        pass
    (tmp_path / "out" / ".unfinished.result.x.json").write_text("half")
    (tmp_path / "out" / "figures").mkdir()
    (tmp_path / "out" / "figures" / ".unfinished.a.png").write_text("half")
    holder.kill()
    holder.communicate()
    with pytest.raises(ValueError, match="skipnet train"), owned(tmp_path / "out", "evaluate"):
        pass
    with owned(tmp_path / "out", "train"):
        assert names(tmp_path / "out") == ["figures"] and names(tmp_path / "out/figures") == []


def test_what_another_run_writes_below_is_left_alone(tmp_path):
    with owned(tmp_path / "runs" / "a", "register"):
        (tmp_path / "runs" / "a" / ".unfinished.x").mkdir()
        with owned(tmp_path / "runs", "study results"):
            assert names(tmp_path / "runs" / "a") == [".unfinished.x"]


def test_a_full_disk_is_named_with_its_file(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError) as told:
        append_line(tmp_path / "a.jsonl", {})
    assert told.value.filename == str(tmp_path / "a.jsonl")
    monkeypatch.setattr("pathlib.Path.write_text", full)
    with pytest.raises(OSError) as told:
        write_text(tmp_path / "a.txt", "x")
    assert told.value.filename == str(tmp_path / "a.txt") and names(tmp_path) == ["a.jsonl"]
