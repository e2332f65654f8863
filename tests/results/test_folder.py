"""A run's results replace an earlier run's as a whole, or leave them alone."""

from __future__ import annotations

import threading

import pytest

from skipnet.results.folder import new_results


def write(folder, **contents):
    with new_results(folder) as staging:
        for stem, text in contents.items():
            (staging / f"{stem}.json").write_text(text)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_results_of_another_kind_go_and_it_is_said(tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    write(out, result="a pair")
    (out / "notes.txt").write_text("the user's")
    (out / "aligned.laz").write_text("old")
    assert capsys.readouterr().out == ""
    write(out, poses="many")
    assert names(out) == ["notes.txt", "poses.json"]
    assert "earlier run" in capsys.readouterr().out
    assert names(out.parent) == ["out"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_after_an_error_all_is_as_it_was(tmp_path, error):
    out = tmp_path / "out"
    write(out, result="before")
    with pytest.raises(type(error)) as told, new_results(out) as staging:
        (staging / "result.json").write_text("half")
        raise error
    assert (out / "result.json").read_text() == "before" and names(out) == ["result.json"]
    with pytest.raises(type(error)), new_results(tmp_path / "new"):
        raise error
    assert names(tmp_path) == ["out"]
    assert not isinstance(error, OSError) or str(out) in str(told.value)


def test_runs_at_the_same_time_do_not_mix(tmp_path):
    out = tmp_path / "out"
    threads = [
        threading.Thread(target=write, args=(out,), kwargs={"result": str(k), "poses": str(k)})
        for k in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (out / "result.json").read_text() == (out / "poses.json").read_text()
    assert names(out) == ["poses.json", "result.json"] and names(tmp_path) == ["out"]
