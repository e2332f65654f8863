"""Wall-clock time per stage: what ``timings_s`` of a result holds."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from skipnet.progress import tell


class Stopwatch:
    """Adds up wall-clock seconds per named stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time the body of a ``with`` under the stage's name."""
        tell(stage)
        start = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
