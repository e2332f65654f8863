"""A file of what somebody believes of many scans: rough places, poses, links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skipnet.checks import suggestion
from skipnet.projects.priors import Priors
from skipnet.projects.ways import PairKey
from skipnet.registration.prior import Prior

_PARTS = ("positions_m", "position_std_m", "poses", "links", "non_links")
_STDS = ("position_std_m", "rotation_std_deg")
_CSV_HEAD = ("scan", "x_m", "y_m", "z_m")


def read_priors(path: Path, names: Sequence[str]) -> Priors:
    """Priors of a YAML file, or positions of a CSV file with the columns scan, x_m, y_m, z_m.

    Args:
        path: the file; a scan is named in it by its file's name, or its number from 0 on.
        names: of the scans.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it names an unknown scan, or holds something else than priors.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file with priors")
    try:
        text = path.read_text("utf-8")
        table = _of_csv(text) if path.suffix.lower() == ".csv" else _of_yaml(text)
        return _priors(table, _Numbers(names))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())[:200]}") from error


class _Numbers:
    """Numbers of scans by their names."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)

    def __getitem__(self, name: object) -> int:
        if isinstance(name, int):
            return name
        found = [k for k, known in enumerate(self._names) if name in (known, Path(known).name)]
        if len(found) != 1:
            many = "several scans are" if found else "no scan is"
            raise ValueError(f"{many} called {name!r}{suggestion(str(name), self._names)}")
        return found[0]


def _of_yaml(text: str) -> dict[str, Any]:
    import yaml

    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(f"is no YAML: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"expected some of {', '.join(_PARTS)}")
    return content


def _of_csv(text: str) -> dict[str, Any]:
    import csv

    rows = list(csv.DictReader(text.splitlines(), skipinitialspace=True))
    if not rows or not set(_CSV_HEAD) <= set(rows[0]):
        raise ValueError(f"expected the columns {', '.join(_CSV_HEAD)}")
    return {
        "positions_m": {row["scan"]: [float(row[axis]) for axis in _CSV_HEAD[1:]] for row in rows}
    }


def _priors(table: Mapping[str, Any], numbers: _Numbers) -> Priors:
    for part in table:
        if part not in _PARTS:
            raise ValueError(f"unknown part {part!r}{suggestion(str(part), _PARTS)}")
    std_m = {name: table[name] for name in ("position_std_m",) if name in table}
    return Priors(
        positions_m={numbers[name]: xyz for name, xyz in table.get("positions_m", {}).items()},
        poses={numbers[name]: _pose(one, "T") for name, one in table.get("poses", {}).items()},
        links=dict(_link(one, numbers) for one in table.get("links", [])),
        non_links=[(numbers[a], numbers[b]) for a, b in table.get("non_links", [])],
        **std_m,
    )


def _link(one: Mapping[str, Any], numbers: _Numbers) -> tuple[PairKey, Prior | None]:
    prior = _pose(one, "T_target_source") if "T_target_source" in one else None
    return (numbers[one["target"]], numbers[one["source"]]), prior


def _pose(one: Mapping[str, Any], name: str) -> Prior:
    return Prior(one[name], *(one.get(std) for std in _STDS))
