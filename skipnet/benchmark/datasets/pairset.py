"""What every data set comes to: named pairs, read when asked for, and the choice among them."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skipnet.checks import check_known
from skipnet.geometry import invert, make_transform, random_rotation, transform_points
from skipnet.types import FloatArray, Pair


@dataclass(frozen=True)
class PairSet:
    """Named pairs, each made or read when asked for; an index always gives the same pair."""

    names: tuple[str, ...]
    load: Callable[[int], Pair]

    def __post_init__(self) -> None:
        repeated = sorted(name for name, count in Counter(self.names).items() if count > 1)
        if repeated:
            raise ValueError(f"pair names must be unique, but {repeated} occur more than once")

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Pair]:
        return (self.load(index) for index in range(len(self)))


@dataclass(frozen=True)
class Listed:
    """A pair that a data set's folder lists, not read yet; the truth came with the list."""

    name: str
    set_name: str
    """The scene, sequence or set within the data set."""
    source: Path
    target: Path
    T_target_source: FloatArray
    """(4, 4), the truth."""
    overlap: float | None = None
    """As the data set gives it."""
    information: FloatArray | None = None
    """(6, 6) of gt.info, see ``Pair.information``."""
    consecutive: bool = False
    """The scans follow each other in the sequence."""
    success_rotation_deg: float = 5.0
    success_translation_m: float = 0.3

    def read(self, read_points: Callable[[Path], FloatArray]) -> Pair:
        """The pair with its points."""
        return Pair(
            name=self.name,
            set_name=self.set_name,
            source_m=read_points(self.source),
            target_m=read_points(self.target),
            T_target_source=self.T_target_source,
            success_rotation_rad=float(np.deg2rad(self.success_rotation_deg)),
            success_translation_m=self.success_translation_m,
            overlap=self.overlap,
            information=self.information,
            consecutive=self.consecutive,
        )


def select(
    listed: Sequence[Listed], sets: Sequence[str] = (), most_per_set: int | None = None
) -> list[Listed]:
    """The pairs of the named sets, of each at most so many, spread evenly over its list.

    Args:
        listed: all pairs of a data set.
        sets: names of the sets to keep; empty keeps all.
        most_per_set: None keeps all.

    Raises:
        ValueError: if a set is not there.
    """
    known = list(dict.fromkeys(pair.set_name for pair in listed))
    for name in sets:
        check_known("sets", name, tuple(known))
    chosen = []
    for name in known:
        if not sets or name in sets:
            of_set = [pair for pair in listed if pair.set_name == name]
            count = len(of_set) if most_per_set is None else min(most_per_set, len(of_set))
            chosen += [
                of_set[i] for i in np.linspace(0, len(of_set) - 1, count).round().astype(int)
            ]
    return chosen


def move_source(pair: Pair, seed: int, turn: bool, shift_m: float) -> Pair:
    """The pair with its source in a new frame, and the truth that goes with it.

    The source is turned about its own origin by a rotation drawn uniformly from SO(3) (seeded by
    ``seed`` and the pair's name, so a subset of the pairs sees the same motions) and then shifted.
    The origin, where many scanners stand, stays the viewpoint unless there is a shift.

    Raises:
        ValueError: for a shift of a pair with gt.info, whose figures are about the source's origin.
    """
    if shift_m and pair.information is not None:
        raise ValueError(f"shift_m={shift_m:g}: gt.info holds for unshifted sources; use shift_m=0")
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
        information=_turned(pair.information, rotation),
    )


def _turned(information: FloatArray | None, rotation: FloatArray) -> FloatArray | None:
    """The same quadratic form for an error (t, q) whose halves turned with the source's frame."""
    if information is None:
        return None
    both = np.kron(np.eye(2), rotation)
    return both @ information @ both.T
