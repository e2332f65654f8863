"""Pairs that were searched, on disk: one JSON file each, whole or not at all, found by content."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.projects.schedule import Outcome
from skipnet.provenance import __version__
from skipnet.registration.findings import Findings
from skipnet.registration.judging.furnishing import Furnishing
from skipnet.registration.judging.pieces import Pieces
from skipnet.registration.judging.sides import Before
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.prior import Prior, PriorCheck
from skipnet.registration.result import Registration, ScanFacts
from skipnet.scans.describing import common_voxel_size_m
from skipnet.scans.scan import AutoAt, Viewpoint
from skipnet.skipmap.tree import Points, points_of
from skipnet.storage import read_json, write_text
from skipnet.types import FloatArray, Status

_KINDS = {
    kind.__name__: kind
    for kind in (Outcome, Registration, ScanFacts, Findings, Before, Furnishing, Pieces, PriorCheck)
}


class PairStore:
    """Outcomes of pairs in a folder; without one nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def load(self, key: str) -> Outcome | None:
        """What was kept under a key; None where nothing was, or what is there cannot be read."""
        if self._folder is None:
            return None
        try:
            outcome = decoded(read_json(self._file(key)))
        except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
        return outcome if _is_whole(outcome) else None

    def save(self, key: str, outcome: Outcome) -> None:
        """Keep an outcome."""
        if self._folder is not None:
            write_text(self._file(key), json.dumps(encoded(outcome)))

    def _file(self, key: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key}.json"


class PromiseStore:
    """What pairs promise at a glance, in a folder; without one nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def load(self, key: str) -> float | None:
        """What was kept under a key; None where nothing was, or what is there is no number."""
        if self._folder is None:
            return None
        try:
            return float(self._file(key).read_text(encoding="ascii"))
        except (FileNotFoundError, ValueError):
            return None

    def save(self, key: str, value: float) -> None:
        """Keep it, with every bit."""
        if self._folder is not None:
            write_text(self._file(key), repr(value))

    def _file(self, key: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{key}.txt"


def _is_whole(outcome: object) -> bool:
    """Whether it is an outcome with poses; a folder may come from anywhere."""
    if not isinstance(outcome, Outcome) or not isinstance(outcome.result, Registration):
        return False
    result, poses = outcome.result, outcome.finalists
    return (
        isinstance(poses, np.ndarray)
        and poses.shape[1:] == (4, 4)
        and all(
            isinstance(T, np.ndarray) and T.shape == (4, 4) and bool(np.isfinite(T).all())
            for T in (result.T_target_source, result.T_target_source_coarse, *poses)
        )
        and isinstance(result.status, Status)
        and isinstance(result.findings, Findings | None)
        and isinstance(result.source, ScanFacts)
        and isinstance(result.target, ScanFacts)
    )


class SizeStore:
    """The project's voxel size, and the scans that it was chosen from, in a folder."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "voxel_size.json"

    def load(self, digests: Sequence[str]) -> float | None:
        """The size, if it was chosen from some of these scans; else None."""
        try:
            kept = json.loads(self._file.read_text(encoding="utf-8"))
            return float(kept["voxel_size_m"]) if set(kept["scans"]) <= set(digests) else None
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None

    def fixed_m(
        self, given_m: float | None, clouds_m: Sequence[Points], digests: Sequence[str]
    ) -> float:
        """The size: given, kept, or chosen now from the scans and kept."""
        size_m = given_m if given_m is not None else self.load(digests)
        if size_m is None:
            size_m = common_voxel_size_m(clouds_m)
            self.save(size_m, digests)
        return size_m

    def save(self, voxel_size_m: float, digests: Sequence[str]) -> None:
        """Keep it."""
        content = {"voxel_size_m": voxel_size_m, "scans": sorted(digests)}
        write_text(self._file, json.dumps(content))


def digest(points: Points, viewpoint: Viewpoint) -> str:
    """Of what a scan is: its points and its given viewpoint."""
    found = hashlib.sha256(np.ascontiguousarray(points_of(points)).tobytes())
    told = viewpoint if isinstance(viewpoint, str | AutoAt) else _listed(viewpoint)
    found.update(str(told).encode())
    return found.hexdigest()


def pair_key(
    digests: tuple[str, str],
    voxel_size_m: float,
    seed: int,
    config: RegistrationConfig,
    prior: Prior | None = None,
) -> str:
    """Of a search: both scans, every option, what was believed, the version of this package."""
    options = json.dumps(dataclasses.asdict(config), default=str, sort_keys=True)
    believed = [] if prior is None else [_believed(prior)]
    text = json.dumps([*digests, voxel_size_m, seed, options, __version__, *believed])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _believed(prior: Prior) -> list[object]:
    T = np.asarray(prior.T_target_source, dtype=np.float64)
    return [T.ravel().tolist(), prior.position_std_m, prior.rotation_std_deg]


def encoded(value: Any) -> Any:
    """Outcomes as JSON knows values; floats keep every bit."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        fields = {name: encoded(getattr(value, name)) for name in names}
        return {"kind": type(value).__name__, "fields": fields}
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "values": value.ravel().tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Status):
        return {"status": str(value)}
    if isinstance(value, list | tuple):
        return {"list": [encoded(item) for item in value]}
    if isinstance(value, dict):
        return {"dict": {str(name): encoded(item) for name, item in value.items()}}
    return value


def decoded(value: Any) -> Any:
    """What ``encoded`` was given.

    >>> decoded(encoded([0.1, Status.FAILED, np.zeros((0, 3))]))[2].shape
    (0, 3)
    """
    if not isinstance(value, dict):
        return value
    if "kind" in value:
        fields = {name: decoded(item) for name, item in value["fields"].items()}
        return _KINDS[value["kind"]](**fields)
    if "shape" in value:
        return np.array(value["values"], dtype=np.float64).reshape(value["shape"])
    if "status" in value:
        return Status(value["status"])
    if "list" in value:
        return [decoded(item) for item in value["list"]]
    return {name: decoded(item) for name, item in value["dict"].items()}


def _listed(viewpoint: FloatArray | Sequence[float] | None) -> list[float] | None:
    return None if viewpoint is None else np.asarray(viewpoint, dtype=np.float64).tolist()
