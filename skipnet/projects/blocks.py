"""Blocks of pairs in other processes, here or on a cluster: what is found lies in the folders.

A block names its scans and pairs by the keys of their files and writes each pair as it is found, so
neither the number of workers nor their order changes a result, and one that dies loses a pair.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from skipnet.networks.catalog import find_network
from skipnet.parallel.threads import processors
from skipnet.projects.schedule import promise, search
from skipnet.projects.store import PairStore, PromiseStore
from skipnet.registration.options import RegistrationConfig
from skipnet.scans.scan import Scan
from skipnet.scans.store import ScanStore

PAIRS_PER_BLOCK = 16
"""A few seconds' work: little is lost with a worker, little time goes into starting one."""
TRIES = 2
SCANS_AT_HAND = 32
"""Described scans that a worker keeps in memory."""


@dataclass(frozen=True)
class Task:
    """One pair that is to be searched, by the names of the files that it needs and gives."""

    target: str
    source: str
    outcome: str
    is_glance: bool = False
    """Whether only its promise is wanted."""

    def is_done(self, folder: Path) -> bool:
        """Whether the project's folder has what it gives."""
        if self.is_glance:
            return PromiseStore(folder / "promises").load(self.outcome) is not None
        return PairStore(folder / "pairs").load(self.outcome) is not None

    def do(self, folder: Path, config: RegistrationConfig) -> None:
        """Search the pair, or glance at it, and leave what is found in the folder."""
        source, target = (_scan(folder, name, config) for name in (self.source, self.target))
        if self.is_glance:
            found = promise(source, target, config)
            PromiseStore(folder / "promises").save(self.outcome, found)
        else:
            PairStore(folder / "pairs").save(self.outcome, search(source, target, config))


@dataclass(frozen=True)
class Workers:
    """Who searches: so many processes, of this machine or of a Ray cluster."""

    count: int = 1
    """1: this process; -1: as many as the machine, or the cluster, has processors."""
    executor: str = "local"
    """"local", "ray" (a cluster of this machine), or a cluster's address, "ray://host:port". Its
    machines must see the project's folder under the same path."""

    def __post_init__(self) -> None:
        if self.count != -1 and self.count < 1:
            raise ValueError(f"workers={self.count}: expected 1 or more, or -1 for all processors")
        if self.executor not in ("local", "ray") and not self.executor.startswith("ray://"):
            raise ValueError(f"executor={self.executor!r}: expected local, ray or ray://host:port")

    @property
    def is_here(self) -> bool:
        """Whether this process does the work itself."""
        return self.executor == "local" and (processors() if self.count == -1 else self.count) == 1


def search_tasks(
    tasks: Sequence[Task], folder: Path, config: RegistrationConfig, workers: Workers
) -> None:
    """Search pairs in blocks and leave what is found in the folder.

    Raises:
        RuntimeError: a worker ended twice over some pairs; they are named, all others are kept.
    """
    folder = folder.absolute()  # workers may have begun in another folder
    left = [task for task in tasks if not task.is_done(folder)]
    for _ in range(TRIES):
        blocks = [left[i : i + PAIRS_PER_BLOCK] for i in range(0, len(left), PAIRS_PER_BLOCK)]
        _try_all(blocks, folder, config, workers)
        left = [task for task in left if not task.is_done(folder)]
        if not left:
            return
    names = ", ".join(f"{task.outcome}.json" for task in left[:5])
    raise RuntimeError(
        f"{len(left)} pairs were not searched, because workers ended {TRIES} times over them "
        f"({names}); memory may be short: try fewer workers"
    )


def search_block(tasks: Sequence[Task], folder: Path, config: RegistrationConfig) -> None:
    """Search the pairs of one block that are not there yet."""
    for task in tasks:
        if not task.is_done(folder):
            task.do(folder, config)


@lru_cache(SCANS_AT_HAND)
def _described(folder: Path, name: str, network: str, device: str) -> Scan:
    scan = ScanStore(folder / "scans").load(name, find_network(network, device))
    if scan is None:
        raise FileNotFoundError(f"{folder / 'scans' / name}.npz: expected a described scan")
    return scan


def _scan(folder: Path, name: str, config: RegistrationConfig) -> Scan:
    return _described(folder, name, config.network, config.device)


def _try_all(
    blocks: Sequence[Sequence[Task]],
    folder: Path,
    config: RegistrationConfig,
    workers: Workers,
) -> None:
    """Let workers do all blocks; what a worker that ended has not done is found missing later."""
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    with _backend(workers.executor):
        try:
            Parallel(n_jobs=workers.count, batch_size=1)(
                delayed(search_block)(block, folder, config) for block in blocks
            )
        except (BrokenProcessPool, *_lost_workers()):
            return


def _backend(executor: str) -> AbstractContextManager[object]:
    """What joblib runs its work on."""
    from joblib import parallel_config

    if executor == "local":
        return parallel_config("loky", inner_max_num_threads=1)
    import ray
    from ray.util.joblib import register_ray

    if not ray.is_initialized():
        ray.init(address=None if executor == "ray" else executor)
    register_ray()
    return parallel_config("ray")


def _lost_workers() -> tuple[type[Exception], ...]:
    """What Ray raises for a worker that ended, where it is installed."""
    try:
        from ray.exceptions import RayActorError, WorkerCrashedError
    except ImportError:
        return ()
    return RayActorError, WorkerCrashedError
