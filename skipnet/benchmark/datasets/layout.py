"""Data sets in a folder: how each is read, judged, and where to get it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skipnet.benchmark.datasets.pairset import Listed, PairSet, move_source, select
from skipnet.benchmark.options import EvaluateConfig, ProtocolKind
from skipnet.clouds.formats.reading import read_points
from skipnet.types import FloatArray, Pair


@dataclass(frozen=True)
class Layout:
    """A published layout of a folder; called with options it makes the ``Dataset``."""

    name: str
    list_pairs: Callable[[Path], list[Listed]]
    """The pairs in a folder; empty when the folder holds something else."""
    layout: str
    """What the folder must hold, for messages."""
    source: str
    """Where to get it."""
    protocol: ProtocolKind
    """The rule by which results on it are published."""
    read_points: Callable[[Path], FloatArray] = read_points
    finish: Callable[[Pair], Pair] | None = None
    """Last step of reading a pair."""

    def __call__(self, config: EvaluateConfig) -> Folder:
        """The data set in the folder that the options name."""
        return Folder(self, config)

    def pairs(
        self,
        folder: str | Path | None,
        sets: Sequence[str] = (),
        turn: bool = True,
        shift_m: float = 0.0,
        seed: int = 0,
        most_per_set: int | None = None,
    ) -> PairSet:
        """The pairs in a folder, each source first moved at random.

        Shipped pairs are often nearly aligned, which would flatter local methods. The errors that
        the protocols look at do not depend on the turn.

        Args:
            folder: holds the data set in its published layout.
            sets: names of the sets, scenes or sequences to keep; empty keeps all.
            turn: whether to turn the sources, see ``move_source``.
            shift_m: length of the shift, in a random direction.
            seed: seed of the random motions.
            most_per_set: keep at most so many pairs of each set; None keeps all.

        Raises:
            FileNotFoundError: the folder does not hold it; the message says where to get it.
            ValueError: a file is not what it should be, or a set is unknown.
        """
        chosen = select(self._list(folder), sets, most_per_set)

        def load(index: int) -> Pair:
            """The chosen pair of that index, read from its files and moved."""
            pair = chosen[index].read(self.read_points)
            pair = self.finish(pair) if self.finish else pair
            return move_source(pair, seed, turn, shift_m) if turn or shift_m else pair

        return PairSet(tuple(pair.name for pair in chosen), load)

    def _list(self, folder: str | Path | None) -> list[Listed]:
        where = f"data=FOLDER must name one with {self.layout}; get it: {self.source}"
        if folder is None:
            raise FileNotFoundError(f"dataset={self.name} needs a folder: {where}")
        try:
            listed = self.list_pairs(Path(folder))
        except FileNotFoundError as error:
            raise FileNotFoundError(f"{error}; {where}") from error
        if not listed:
            raise FileNotFoundError(f"no {self.name} pairs in {folder}: {where}")
        return listed


@dataclass(frozen=True)
class Folder:
    """A data set in the folder that the options name: ``Dataset``."""

    layout: Layout
    config: EvaluateConfig

    @property
    def protocol(self) -> ProtocolKind:
        """That of the layout."""
        return self.layout.protocol

    def pairs(self) -> PairSet:
        """See ``Layout.pairs``."""
        c = self.config
        return self.layout.pairs(c.data, c.sets, c.turn, c.shift_m, c.seed, c.most_per_set)

    def describe(self) -> dict[str, str]:
        """Where they lie and how they were moved."""
        c = self.config
        most = "" if c.most_per_set is None else f", at most {c.most_per_set} of each"
        rotation = "a random rotation" if c.turn else "no rotation"
        sets = ", ".join(c.sets) or "all sets"
        return {
            "pairs from": f"{self.layout.name} in {c.data} ({sets}{most})",
            "sources moved by": f"{rotation}, a shift of {c.shift_m:g} m",
        }

    def key(self) -> list[Any]:
        """The folder, and the random motions."""
        c = self.config
        return [self.layout.name, str(Path(str(c.data)).resolve()), c.turn, c.shift_m, c.seed]
