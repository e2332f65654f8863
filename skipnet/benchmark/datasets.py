"""Where the pairs come from: simulated families, or a folder of real scans with a pairs.json.

A pair set knows its names at once and makes or reads its pairs one at a time, so that a resumed run
loads only what is missing. The truth is inside each ``Pair``; only the scorer looks at it.
"""

from __future__ import annotations

import difflib
import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skipnet.geometry import invert, make_transform, random_rotation, transform_points
from skipnet.types import Pair

PAIRS_FILE = "pairs.json"


@dataclass(frozen=True)
class PairSet:
    """Named pairs, each made or read when asked for; an index always gives the same pair."""

    names: tuple[str, ...]
    load: Callable[[int], Pair]

    def __post_init__(self) -> None:
        repeated = {name for name in self.names if self.names.count(name) > 1}
        if repeated:
            raise ValueError(
                f"pair names must be unique, but {sorted(repeated)} occur more than once"
            )

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Pair]:
        return (self.load(index) for index in range(len(self)))


def simulated_pairs(
    family: str,
    count: int,
    seed: int = 0,
    scanner: str = "terrestrial",
    rotation: str = "yaw",
    points: int | None = None,
) -> PairSet:
    """``count`` simulated pairs of one family; pair i is made from seed ``seed + i``.

    Args:
        family: one of ``skipnet.simulation.scenes.FAMILIES``.
        count: number of pairs, at least 1.
        seed: seed of the first pair.
        scanner: one of ``skipnet.simulation.scanner.SCANNERS``.
        rotation: "yaw" keeps the second scanner upright, "any" turns it freely.
        points: beams per scan; None takes the scanner's own number.
    """
    from skipnet.simulation.pairs import ROTATIONS, simulate_pair
    from skipnet.simulation.scanner import SCANNERS
    from skipnet.simulation.scenes import FAMILIES

    if count < 1:
        raise ValueError(f"pairs={count}: expected at least one simulated pair")
    # Here, not at the first pair: a run that cannot start should leave no folder behind.
    _check_known("family", family, FAMILIES)
    _check_known("scanner", scanner, tuple(SCANNERS))
    _check_known("rotation", rotation, ROTATIONS)

    def load(index: int) -> Pair:
        simulated = simulate_pair(family, seed + index, scanner, rotation, points)
        return replace(simulated.pair, name=names[index])

    names = tuple(f"{family}_{seed + index:04d}" for index in range(count))
    return PairSet(names, load)


def folder_pairs(
    folder: str | Path,
    sets: list[str] | None = None,
    turn: bool = True,
    shift_m: float = 0.0,
    seed: int = 0,
) -> PairSet:
    """The pairs that ``pairs.json`` in ``folder`` lists, each source first moved at random.

    Shipped pairs are often nearly aligned, which would flatter local methods. The source is turned
    about its own origin by a rotation drawn uniformly from SO(3) (seeded by ``seed`` and the pair's
    name, so a subset of the pairs sees the same motions) and then shifted. The origin, where many
    scanners stand, stays the viewpoint unless there is a shift.

    Args:
        folder: holds ``pairs.json`` and the clouds. Each entry of its list ``pairs`` has set,
            source, target (paths in the folder), T_target_source (4x4, metres),
            success_rotation_deg, success_translation_m and perhaps overlap.
        sets: names of the sets to keep; None or empty keeps all.
        turn: whether to turn the sources.
        shift_m: length of the shift, in a random direction.
        seed: seed of the random motions.
    """
    folder = Path(folder)
    entries = _read_entries(folder, sets)
    names = tuple(_pair_name(entry) for entry in entries)

    def load(index: int) -> Pair:
        pair = _read_pair(folder, entries[index], names[index])
        return move_source(pair, seed, turn, shift_m) if turn or shift_m else pair

    return PairSet(names, load)


def move_source(pair: Pair, seed: int, turn: bool, shift_m: float) -> Pair:
    """The pair with its source in a new frame, and the truth that goes with it."""
    rng = np.random.default_rng([seed, zlib.crc32(pair.name.encode())])
    rotation = random_rotation(rng) if turn else np.eye(3)
    direction = rng.standard_normal(3)
    T_moved_source = make_transform(rotation, shift_m * direction / np.linalg.norm(direction))
    viewpoint_m = pair.source_viewpoint_m
    if viewpoint_m is not None:
        viewpoint_m = transform_points(T_moved_source, np.atleast_2d(viewpoint_m))[0]
    return replace(
        pair,
        source_m=transform_points(T_moved_source, np.asarray(pair.source_m, dtype=np.float64)),
        source_viewpoint_m=viewpoint_m,
        T_target_source=pair.T_target_source @ invert(T_moved_source),
    )


def _check_known(option: str, given: str, known: tuple[str, ...]) -> None:
    if given not in known:
        near = difflib.get_close_matches(given, known, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"{option}={given}: {hint}expected one of {', '.join(known)}")


def _read_entries(folder: Path, sets: list[str] | None) -> list[dict[str, Any]]:
    path = folder / PAIRS_FILE
    if not path.is_file():
        raise FileNotFoundError(
            f"no {PAIRS_FILE} in {folder}: name the folder that holds it with data=FOLDER"
        )
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))["pairs"]
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(f'{path} is not a JSON object with a list "pairs": {error!r}') from error
    known = sorted({entry["set"] for entry in entries})
    unknown = sorted(set(sets or ()) - set(known))
    if unknown:
        raise ValueError(f"sets {unknown} are not in {path}; it has {known}")
    chosen = [entry for entry in entries if not sets or entry["set"] in sets]
    if not chosen:
        raise ValueError(f"{path} lists no pairs")
    return chosen


def _pair_name(entry: dict[str, Any]) -> str:
    return f"{entry['set']}/{Path(entry['source']).stem}-to-{Path(entry['target']).stem}"


def _read_pair(folder: Path, entry: dict[str, Any], name: str) -> Pair:
    from skipnet.clouds.formats import read_points

    T_target_source = np.asarray(entry["T_target_source"], dtype=np.float64)
    if T_target_source.shape != (4, 4):
        raise ValueError(f"{name}: T_target_source must be 4x4, got shape {T_target_source.shape}")
    return Pair(
        name=name,
        set_name=entry["set"],
        source_m=read_points(folder / entry["source"]),
        target_m=read_points(folder / entry["target"]),
        T_target_source=T_target_source,
        success_rotation_rad=float(np.deg2rad(entry["success_rotation_deg"])),
        success_translation_m=float(entry["success_translation_m"]),
        overlap=entry.get("overlap"),
    )
