"""docs/results.md: its blocks, what fills them, and that no figure of another version stays."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from skipnet.commands.study import main
from skipnet.provenance import machine
from skipnet.studies import results
from skipnet.studies.measured import BLOCKS, Block
from skipnet.studies.options import ResultsConfig
from skipnet.studies.overview import overview
from skipnet.studies.results import NOT_MEASURED, OWN_BLOCKS, STATE_FILE, chosen, excerpt, fill
from skipnet.studies.vigilance import POSITIVES
from tests.composing import evaluate_options

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "results.md").read_text()
MARKS = re.findall(r"<!-- measured: (\w+) -->(.*?)<!-- end of \1 -->", PAGE, flags=re.DOTALL)

REPORT = """# A run

- benchmark: toy
- seed: 0

Nothing was fooled.

## Success by set

| | a |
|---|---:|
| skipnet | 3 of 3 |

Right: as it should be.

## Every pair

| | b |
|---|---:|
| 1 | 2 |

![a picture](figures/a.png)

a picture

skipnet 0.1.0, python 3.11
"""


def test_the_page_has_every_block_once():
    names = [name for name, _ in MARKS]
    assert sorted(names) == sorted([*OWN_BLOCKS, *(block.name for block in BLOCKS)])
    assert PAGE.count("<!-- measured: ") == PAGE.count("<!-- end of ") == len(names)


def test_no_table_stands_outside_the_blocks():
    outside = re.sub(r"<!-- measured: (\w+) -->.*?<!-- end of \1 -->", "", PAGE, flags=re.DOTALL)
    assert [line for line in outside.splitlines() if line.startswith("|")] == []


def test_all_figures_of_the_page_are_of_one_commit():
    """Either the version is named and blocks have figures, or none has."""
    of = dict(MARKS)
    measured = {name for name, text in of.items() if NOT_MEASURED not in text}
    assert not measured or "version" in measured
    assert "version" not in measured or of["version"].count("- commit: ") == 1


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.command.startswith("evaluate")])
@pytest.mark.parametrize("small", [False, True])
def test_every_benchmark_of_the_page_composes(block, small):
    _, *overrides = block.arguments("anywhere", small)
    assert evaluate_options(*overrides).methods


def test_a_command_is_shown_as_it_is_typed():
    folder = Block("real", "evaluate benchmark=folder data=FOLDER", small="pairs=1")
    assert folder.needs_data and folder.line == "python evaluate.py benchmark=folder data=FOLDER"
    assert folder.arguments("my pairs", False) == ["evaluate", "benchmark=folder", "data=my pairs"]
    assert folder.arguments("x", True)[-1] == "pairs=1"
    assert Block("it", "study accuracy pairs=2").line == "skipnet study accuracy pairs=2"


def test_an_excerpt_has_the_sentences_and_the_tables_named():
    text = excerpt(REPORT, ("Success",))
    assert text.startswith("Nothing was fooled.\n\n**Success by set**\n\n| | a |")
    assert text.endswith("Right: as it should be.")
    assert excerpt(REPORT, ("Every",)).endswith("| 1 | 2 |")
    assert excerpt("| all |\n", ()) == "| all |"


def test_blocks_are_replaced_and_the_rest_of_a_page_stays(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- measured: one -->\nold\n<!-- end of one -->\nb\n")
    fill(page, {"one": "new | \\1"})
    assert page.read_text() == "a\n<!-- measured: one -->\nnew | \\1\n<!-- end of one -->\nb\n"
    page.write_text("<!-- measured: two -->\n")
    with pytest.raises(ValueError, match="two"):
        fill(page, {"one": ""})
    page.write_text("<!-- measured: one -->\n")
    with pytest.raises(ValueError, match="has no <!-- end of one -->"):
        fill(page, {"one": ""})


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout with a page of two blocks, and a command that takes no time."""
    blocks = (Block("one", "study one", ("Counts",)), Block("two", "study two", ("Counts",)))
    ran = []

    def run_command(command, **options):
        if command[0] == "git":
            return subprocess_run(command, **options)
        *_, name, output = command
        folder = Path(output.removeprefix("output_dir="))
        ran.append(name)
        folder.mkdir(parents=True, exist_ok=True)
        table = f"## Counts\n\n| | n |\n|---|---:|\n| {name} | {len(ran)} |\n"
        (folder / "report.md").write_text(f"# {name}\n\n{table}\nskipnet 0.1.0\n")
        return subprocess.CompletedProcess(command, 1 if name in broken else 0)

    broken: set[str] = set()
    subprocess_run = subprocess.run
    monkeypatch.setattr(results, "BLOCKS", blocks)
    monkeypatch.setattr(results.subprocess, "run", run_command)
    monkeypatch.chdir(tmp_path)
    marks = "".join(
        f"<!-- measured: {n} -->\n<!-- end of {n} -->\n" for n in ("version", "one", "two")
    )
    Path("page.md").write_text(marks)
    Path("code.py").write_text("1")
    for words in ("init -q", "add .", "commit -qm first"):
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess_run(["git", *who, *words.split()], check=True)
    return ran, broken


CONFIG = ResultsConfig(output_dir="runs", pages=["page.md"])


def commit_a_change():
    Path("code.py").write_text("2")
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    subprocess.run(["git", *who, "commit", "-qam", "second"], check=True, capture_output=True)


def test_everything_is_measured_once_on_a_commit_and_anew_on_the_next(checkout):
    ran, _ = checkout
    first = results.run(CONFIG)
    assert ran == ["one", "two"] and first["measured"] == ["one", "two"]
    page = Path("page.md").read_text()
    assert f"- commit: {first['commit']}\n" in page and "| two | 2 |" in page
    assert machine()["processor"] in page
    results.run(CONFIG)
    assert ran == ["one", "two"]
    commit_a_change()
    second = results.run(ResultsConfig(output_dir="runs", pages=["page.md"], only=["two"]))
    assert ran == ["one", "two", "two"] and second["commit"] != first["commit"]
    page = Path("page.md").read_text()
    assert second["commit"] in page and first["commit"] not in page
    assert page.count(NOT_MEASURED) == 1 and "| two | 3 |" in page and "| one |" not in page


def test_a_failed_command_stops_the_run_and_what_was_measured_stays(checkout):
    ran, broken = checkout
    broken.add("two")
    with pytest.raises(ValueError, match="two: the command ended with exit code 1"):
        results.run(CONFIG)
    assert "| one | 1 |" in Path("page.md").read_text()
    broken.clear()
    results.run(CONFIG)
    assert ran == ["one", "two", "two"]
    assert json.loads(Path("runs", "two", STATE_FILE).read_text())["finished"]


def test_a_folder_of_something_else_is_left_alone(checkout):
    Path("runs", "one").mkdir(parents=True)
    Path("runs", "one", "thesis.txt").write_text("years")
    with pytest.raises(ValueError, match="no run of this study"):
        results.run(CONFIG)
    assert Path("runs", "one", "thesis.txt").exists()


def test_changed_files_have_no_commit(checkout):
    Path("code.py").write_text("3")
    with pytest.raises(ValueError, match="code.py is changed"):
        results.run(CONFIG)
    Path("page.md").write_text(Path("page.md").read_text() + "more\n")
    results.run(ResultsConfig(output_dir="runs", pages=["page.md"], small=True))
    assert "tiny sizes" in Path("page.md").read_text()


def test_without_real_pairs_their_blocks_are_left_out(capsys):
    without = {block.name for block in chosen(ResultsConfig())}
    assert without == {block.name for block in BLOCKS if not block.needs_data}
    assert "real: left out, it needs data=FOLDER" in capsys.readouterr().err
    assert len(chosen(ResultsConfig(data="x"))) == len(BLOCKS)
    with pytest.raises(ValueError, match="only=papr: did you mean paper"):
        chosen(ResultsConfig(only=["papr"]))


def test_outside_a_checkout_it_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["results"]) == 2
    assert "stand in a checkout" in capsys.readouterr().err


def test_the_overview_counts_by_hand(tmp_path):
    rows = [
        ("skipnet", "fine", "True", "registered"),
        ("skipnet", "fine", "False", "registered"),
        ("skipnet", "fine", "True", "failed"),
        ("skipnet", "coarse", "True", "registered"),
        ("icp", "fine", "True", "registered"),
    ]
    lines = ["method,stage,success,status", *(",".join(row) for row in rows)]
    (tmp_path / "scores.csv").write_text("\n".join(lines) + "\n")
    outcomes = [
        ("rings: a/b/c 1-1", True, "registered"),
        ("corridor: a/b/c 1-1", False, "ambiguous"),
        ("negatives, one shell: a/b/c 1-2", False, "failed"),
    ]
    with open(tmp_path / "outcomes.jsonl", "w") as file:
        for job, right, status in outcomes:
            file.write(
                json.dumps({"job": job, "outcome": {"right": right, "status": status}}) + "\n"
            )
    text = overview({"paper": tmp_path, "vigilance": tmp_path})
    assert "| 3 simulated rooms of the paper | 2 | 2 | 1 |" in text
    assert f"| 1 simulated pairs of {len(POSITIVES)} kinds | 1 | 1 | 0 |" in text
    assert "| 1 pairs of different rooms | 0 | 0 | 0 |" in text
    assert overview({}) == ""
