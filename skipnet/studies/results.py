"""Every table of docs/results.md, measured on one commit: ``make results``.

Each block of the page comes from one command, run as a user would type it, in a folder of its own.
What was measured on this commit is not measured again; what was measured on another is thrown away,
so no figure of an older version stays in the page.
"""

from __future__ import annotations

import datetime
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from skipnet.benchmark.reporting.pages import run_versions
from skipnet.checks import check_known
from skipnet.progress import say
from skipnet.provenance import machine
from skipnet.storage import read_json, write_text
from skipnet.studies.measured import BLOCKS, Block
from skipnet.studies.options import ResultsConfig
from skipnet.studies.overview import overview

STATE_FILE = "measured.json"
NOT_MEASURED = "Not measured on this version: `make results`."
OWN_BLOCKS = ("version", "overview")
"""What is known when all is measured: commit and machine, and the headline."""


def run(config: ResultsConfig) -> dict[str, Any]:
    """Measure what is missing, write the pages and say what stands in them.

    Raises:
        ValueError: no commit to name, changed files, an unknown block, or a command that failed;
            what was measured before it is kept.
    """
    blocks = chosen(config)
    commit = _commit(config)
    try:
        for block in blocks:
            measure(block, config, commit)
    finally:
        states = {b.name: _read_state(_folder(config, b)) for b in BLOCKS}
        of_commit = {
            name: state
            for name, state in states.items()
            if "finished" in state and (state["commit"], state["small"]) == (commit, config.small)
        }
        for page in config.pages:
            fill(Path(page), texts(config, commit, of_commit))
    return {"commit": commit, "measured": sorted(of_commit), "pages": list(config.pages)}


def chosen(config: ResultsConfig) -> list[Block]:
    """The blocks to measure: those named, or all for which there are scans."""
    for name in config.only:
        check_known("only", name, tuple(block.name for block in BLOCKS))
    wanted = [block for block in BLOCKS if not config.only or block.name in config.only]
    for block in wanted:
        if block.needs_data and config.data is None:
            say(f"{block.name}: left out, it needs data=FOLDER")
    return [block for block in wanted if config.data is not None or not block.needs_data]


def measure(block: Block, config: ResultsConfig, commit: str) -> None:
    """Run the block's command, unless this commit's figures are there already."""
    folder, arguments = _folder(config, block), block.arguments(config.data, config.small)
    arguments += [f"seed={config.seed}"] if config.seed else []
    state = _read_state(folder)
    begun = (state.get("commit"), state.get("arguments")) == (commit, arguments)
    if begun and "finished" in state:
        return
    if folder.exists() and not state:
        raise ValueError(f"{folder} is no run of this study: choose another output_dir")
    if folder.exists() and not (begun and block.resumes):
        shutil.rmtree(folder)
    state = {"commit": commit, "arguments": arguments, "small": config.small}
    write_text(folder / STATE_FILE, json.dumps(state, indent=1))
    say(f"{block.name}: {block.line}")
    started = time.monotonic()
    command = [sys.executable, "-m", "skipnet", *arguments, f"output_dir={folder}"]
    code = subprocess.run(command, stdout=subprocess.DEVNULL).returncode
    if code != 0:
        raise ValueError(f"{block.name}: the command ended with exit code {code}; mend and repeat")
    state["minutes"] = round((time.monotonic() - started) / 60, 2)
    state["finished"] = datetime.date.today().isoformat()
    write_text(folder / STATE_FILE, json.dumps(state, indent=1))


def texts(config: ResultsConfig, commit: str, states: dict[str, Any]) -> dict[str, str]:
    """Markdown of every block; those that this commit did not measure say so."""
    found = {block.name: NOT_MEASURED for block in BLOCKS}
    for block in BLOCKS:
        if block.name in states:
            report = (_folder(config, block) / block.report).read_text(encoding="utf-8")
            command = f"```bash\n{block.line}\n```"
            found[block.name] = f"{command}\n\n{excerpt(report, block.tables)}"
    found["version"] = _version(commit, states, config.small) if states else NOT_MEASURED
    folders = {block.name: _folder(config, block) for block in BLOCKS if block.name in states}
    found["overview"] = overview(folders) or NOT_MEASURED
    return found


def excerpt(report: str, titles: tuple[str, ...]) -> str:
    """The sentences and the named tables of a report, their titles in bold; all without titles."""
    if not titles:
        return report.strip()
    body = report.rstrip().rpartition("\n")[0]  # the last line has the versions
    preamble, *sections = re.split(r"^## ", body, flags=re.MULTILINE)
    kept = [line for line in preamble.splitlines() if line and line[0] not in "#-"]
    for section in sections:
        title, _, table = section.partition("\n")
        if title.startswith(titles):
            table = table.split("\n![")[0].strip()
            kept.append(f"**{title.strip()}**\n\n{table}")
    return "\n\n".join(kept)


def fill(page: Path, found: dict[str, str]) -> None:
    """Replace what stands between the marks of each block of a page.

    Raises:
        ValueError: the page has a mark that no block has, or no end for it.
    """
    text = page.read_text(encoding="utf-8")
    for name in re.findall(r"<!-- measured: (\w+) -->", text):
        check_known(f"{page}: measured", name, tuple(found))
        begin, end = f"<!-- measured: {name} -->\n", f"<!-- end of {name} -->"
        before, _, rest = text.partition(begin)
        _, mark, after = rest.partition(end)
        if not mark:
            raise ValueError(f"{page}: {begin.strip()} has no {end}")
        text = f"{before}{begin}{found[name].strip()}\n{mark}{after}"
    write_text(page, text)


def _version(commit: str, states: dict[str, Any], small: bool) -> str:
    """Commit, date, machine and versions, in words."""
    dates = sorted({state["finished"] for state in states.values()})
    minutes = sum(state["minutes"] for state in states.values())
    about = {
        "commit": commit + (" (tiny sizes, to see that it works)" if small else ""),
        "date": dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}",
        "machine": ", ".join(f"{name} {value}" for name, value in machine().items()),
        "took": f"{minutes:.0f} minutes for {len(states)} of {len(BLOCKS)} blocks",
        "versions": ", ".join(f"{name} {found}" for name, found in run_versions().items()),
    }
    return "\n".join(f"- {name}: {value}" for name, value in about.items())


def _commit(config: ResultsConfig) -> str:
    """Short name of the commit that is measured."""
    unchanged = [f":!{page}" for page in config.pages]
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", *unchanged)
    if changed and not config.small:
        raise ValueError(f"results are those of a commit, and {changed.split()[1]} is changed")
    return _git("rev-parse", "--short=12", "HEAD")


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise ValueError("results are those of a commit: stand in a checkout, with git") from error
    return done.stdout.strip()


def _folder(config: ResultsConfig, block: Block) -> Path:
    return Path(config.output_dir) / block.name


def _read_state(folder: Path) -> dict[str, Any]:
    path = folder / STATE_FILE
    return read_json(path) if path.exists() else {}
