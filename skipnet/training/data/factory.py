"""A factory of training pairs: scans of every kind, with little overlap on purpose, as they go.

Each number gives one pair of scans and with it a lesson, such as pairs of patches, or nothing where
the scans share too little; the same number always the same. Processes work ahead, and what is
learned from at a step is a window of numbers that depends on the step alone: so an interrupted
training goes on to the bit.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
import torch

from skipnet.features.grids import cylinder_grids, turned_over
from skipnet.metrics.correspondences import TwoScans
from skipnet.parallel.pools import worker_pool
from skipnet.simulation.scanning.degrading import degrade
from skipnet.simulation.scanning.figures import FARTHEST_TURN_RAD, turn_figure, turn_sculpture
from skipnet.simulation.scanning.glimpses import EYES, glimpse
from skipnet.simulation.scanning.recipe import Recipe
from skipnet.simulation.scanning.views import look_around
from skipnet.simulation.seeds import SeedRange
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import build_skipmap
from skipnet.training.data.pairs import PatchPairs, cut_pairs
from skipnet.types import FloatArray

Clouds = tuple[FloatArray, FloatArray, FloatArray]
"""(N, 3) source and (M, 3) target, and the true (4, 4) motion."""
Lesson = TypeVar("Lesson")
AnyFactory = TypeVar("AnyFactory", bound="Factory[Any]")
MIN_POINTS = 2000
AT_FIRST = 16
"""Numbers at hand at the first step."""
AHEAD = 8
"""Numbers that are asked for before they are needed."""
RECIPE = replace(Recipe(), voxel_octaves=0.7, least_kept=0.4, holes=3, turned_share=0.3)
"""How the scans get worse, and how examples are drawn."""


@dataclass(frozen=True)
class Kind:
    """One kind of scans."""

    share: float
    """Of all pairs of scans."""
    families: tuple[str, ...]
    make: Callable[[str, int, np.random.Generator], Clouds]
    blind_share: float = 0.2
    """So often nothing is said of where they were taken from."""


def _views(device: str, farthest_rad: float) -> Callable[[str, int, np.random.Generator], Clouds]:
    def make(family: str, seed: int, rng: np.random.Generator) -> Clouds:
        """Two views that look apart by a drawn angle."""
        scene = look_around(family, seed, device)
        return (*scene.clouds_m(rng.uniform(0, farthest_rad)), scene.T_target_source)

    return make


def _turntable(family: str, seed: int, rng: np.random.Generator) -> Clouds:
    table = turn_sculpture(seed) if family == "sculpture" else turn_figure(seed)
    turn_rad = rng.uniform(0.1, 0.8) * FARTHEST_TURN_RAD
    return (*table.clouds_m(turn_rad), table.T_target_source(turn_rad))


def _glimpses(name: str) -> Callable[[str, int, np.random.Generator], Clouds]:
    return lambda family, seed, rng: glimpse(family, seed, EYES[name], rng)


INDOORS = ("kitchen", "clutter", "gallery", "kitchen", "oblique", "closed", "curved", "paper_room")
OUTDOORS = ("terrain", "facade")
KINDS: dict[str, Kind] = {
    "fragment": Kind(0.22, INDOORS, _glimpses("fragment"), blind_share=0.5),
    "camera": Kind(0.12, INDOORS, _glimpses("camera")),
    "narrow_lidar": Kind(0.09, OUTDOORS, _glimpses("narrow_lidar")),
    "level_lidar": Kind(0.09, OUTDOORS, _glimpses("level_lidar")),
    "turntable": Kind(0.28, ("figure", "sculpture", "sculpture"), _turntable, blind_share=0.5),
    "dome": Kind(0.12, (*INDOORS, *OUTDOORS, "doorway"), _views("dome", 1.8)),
    "rings": Kind(0.08, OUTDOORS, _views("rings", 1.8)),
}
"""What the factory makes, by name."""


def make_scans(number: int) -> TwoScans | None:
    """The pair of scans of that number; None where a scan has too few points."""
    rng = np.random.default_rng([number, 4])
    shares = [kind.share for kind in KINDS.values()]
    kind = KINDS[str(rng.choice(list(KINDS), p=shares))]
    family = str(rng.choice(kind.families))
    try:
        source_m, target_m, T_target_source = kind.make(family, number, rng)
    except ValueError:  # the scene has no free place
        return None
    if min(len(source_m), len(target_m)) < MIN_POINTS:
        return None
    usual_m = choose_voxel_size(source_m, target_m)
    voxel_size_m = usual_m * 2 ** rng.uniform(-RECIPE.voxel_octaves, RECIPE.voxel_octaves)
    noise_m = voxel_size_m * rng.choice(RECIPE.noise_voxels)
    clouds = [degrade(c, voxel_size_m, noise_m, RECIPE, rng) for c in (source_m, target_m)]
    viewpoint_m = None if rng.random() < kind.blind_share else np.zeros(3)
    source, target = (build_skipmap(cloud_m, voxel_size_m, viewpoint_m) for cloud_m in clouds)
    if min(len(source), len(target)) == 0:
        return None
    return TwoScans(source, target, T_target_source, oriented=viewpoint_m is not None)


def make_pairs(number: int, per_scans: int) -> PatchPairs | None:
    """Pairs of patches of the pair of scans of that number; None where it shares too little."""
    scans = make_scans(number)
    if scans is None:
        return None
    rng = np.random.default_rng([number, 5])
    return cut_pairs(scans, per_scans, RECIPE, rng, cylinder_grids, turned_over)


class Factory(Generic[Lesson]):
    """Lessons that never end: a window of numbers, moved on as the training goes.

    Args:
        make: of a number its lesson, None where there is none; a function with keywords that say
            all it depends on.
        numbers: of the pairs of scans; after the last one the first comes again.
        window: so many numbers are at hand at a step, the last ones; fewer at first.
        scans_per_step: what a step takes from the window.
        uses: steps that a pair of scans takes part in, on average, before it leaves the window.
        pool: makes pairs ahead.
        first: number to begin with.
    """

    def __init__(
        self,
        make: partial[Lesson | None],
        numbers: SeedRange,
        window: int,
        scans_per_step: int,
        uses: float,
        pool: Executor,
        first: int = 0,
    ) -> None:
        self._make = make
        self._window, self._rate = window, scans_per_step / uses
        self._numbers, self._pool, self._first = numbers, pool, first
        self._at_first = min(AT_FIRST, window)
        self._ahead: deque[Future[Lesson | None]] = deque()
        self._held: deque[Lesson | None] = deque(maxlen=window)
        self._next = self._asked = 0
        self._counted = 0, time.perf_counter()

    def digest(self) -> str:
        """What tells these lessons from others."""
        what = f"{self._numbers} {self._first} {self._make.keywords} {self._window} {self._rate}"
        return f"factory {what} {list(KINDS)} {RECIPE}"

    def pairs_at(self, step: int) -> Sequence[Lesson]:
        """What a step may learn from; steps must not go back."""
        stop = self._at_first + int(step * self._rate)
        if self._next < stop - self._window:  # a training goes on: what was before is not needed
            self._ahead.clear()
            self._next = self._asked = stop - self._window
        while self._next < stop:
            while self._asked < stop + AHEAD:
                number = self._numbers.scene((self._first + self._asked) % self._numbers.count)
                self._ahead.append(self._pool.submit(self._make, number))
                self._asked += 1
            self._held.append(self._ahead.popleft().result())
            self._next += 1
        return [pairs for pairs in self._held if pairs is not None]

    def figures(self) -> dict[str, float]:
        """For TensorBoard: how fast pairs of scans came since this was last asked."""
        (made, then_s), self._counted = self._counted, (self._next, time.perf_counter())
        speed = (self._counted[0] - made) / max(self._counted[1] - then_s, 1e-9)
        return {"factory/pairs_per_second": speed}


class PatchFactory(Factory[PatchPairs]):
    """Of pairs of patches, for a descriptor."""

    labelled = None

    def scaling(self) -> tuple[torch.Tensor]:
        """Patches from which the scaling of the inputs is taken."""
        return (torch.cat([torch.from_numpy(p.source[:50]).float() for p in self.pairs_at(0)]),)


@contextmanager
def working(workers: int, build: Callable[[Executor], AnyFactory]) -> Iterator[AnyFactory]:
    """A factory, with so many processes that make pairs ahead."""
    with worker_pool(workers) as pool:
        try:
            yield build(pool)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
