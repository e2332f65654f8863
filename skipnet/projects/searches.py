"""Searches of pairs: each is done once, here or by other processes, and what it found is kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

from skipnet.projects.blocks import Task, Workers, search_tasks
from skipnet.projects.priors import Priors
from skipnet.projects.retrieval import ALL_PAIRS, partners
from skipnet.projects.schedule import Outcome, promise, search
from skipnet.projects.store import PairStore, PromiseStore, pair_key
from skipnet.projects.ways import PairKey
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.prior import Prior
from skipnet.scans.scan import Scan

Progress = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""


class Searches:
    """What searching the pairs of a project's scans found so far."""

    def __init__(
        self,
        folder: Path | None,
        seed: int,
        workers: Workers,
        scans: Sequence[Scan],
        scan_names: Sequence[str],
        digests: Sequence[str],
    ) -> None:
        """Begin without any.

        Args:
            folder: where what is found is kept; None: in memory only.
            seed: of every random choice.
            workers: who searches.
            scans: described scans; the project adds to this list, and to the next two.
            scan_names: of their files, where there is a folder.
            digests: of what was given.
        """
        self._folder = folder
        self._seed = seed
        self._workers = workers
        self._scans, self._scan_names, self._digests = scans, scan_names, digests
        self._pairs = PairStore(folder and folder / "pairs")
        self._kept_promises = PromiseStore(folder and folder / "promises")
        self._promises: dict[PairKey, float] = {}
        self._outcomes: dict[PairKey, list[Outcome]] = {}
        self._believed: dict[str, Outcome] = {}

    def worthwhile(
        self, priors: Priors, config: RegistrationConfig, tell: Progress
    ) -> list[PairKey]:
        """The pairs that are searched: all, or of many scans those that promise most."""
        keys = list(combinations(range(len(self._scans)), 2))
        if len(self._scans) <= ALL_PAIRS:
            return keys
        self._outsource(keys, config, "glances at pairs", tell, is_glance=True)
        for done, key in enumerate(keys):
            tell("glances at pairs", done, len(keys))
            if key not in self._promises:
                self._promises[key] = self._promised(key, config)
        tell("glances at pairs", len(keys), len(keys))
        return sorted(partners(self._promises, len(self._scans)) | priors.linked)

    def search(
        self,
        keys: Sequence[PairKey],
        config: RegistrationConfig,
        position: int,
        stage: str,
        tell: Progress,
    ) -> None:
        """Search the pairs of which less than ``position`` + 1 outcomes are known."""
        new = [key for key in keys if len(self._outcomes.setdefault(key, [])) <= position]
        self._outsource(new, config, stage, tell)
        for done, key in enumerate(keys):
            tell(stage, done, len(keys))
            if len(self._outcomes[key]) <= position:
                self._outcomes[key].append(self._found(key, config))
        tell(stage, len(keys), len(keys))

    def search_about(
        self, guesses: Mapping[PairKey, Prior], config: RegistrationConfig, tell: Progress
    ) -> dict[PairKey, Outcome]:
        """What searching pairs about the poses that are believed of them finds."""
        found = {}
        for done, (key, prior) in enumerate(guesses.items()):
            tell("poses that are believed", done, len(guesses))
            name = self._pair_name(key, config, prior)
            if name not in self._believed:
                self._believed[name] = self._found(key, config, prior)
            found[key] = self._believed[name]
        return found

    def known(self, key: PairKey, count: int) -> list[Outcome]:
        """The first outcomes of a pair."""
        return self._outcomes.get(key, [])[:count]

    def _promised(self, key: PairKey, config: RegistrationConfig) -> float:
        """What a glance at a pair said before, or says now."""
        name = self._pair_name(key, config)
        known = self._kept_promises.load(name)
        if known is None:
            known = promise(self._scans[key[1]], self._scans[key[0]], config)
            self._kept_promises.save(name, known)
        return known

    def _outsource(
        self,
        keys: Sequence[PairKey],
        config: RegistrationConfig,
        stage: str,
        tell: Progress,
        is_glance: bool = False,
    ) -> None:
        """Let other processes search pairs, if there are any, and leave what they find."""
        if self._folder is not None and not self._workers.is_here:
            tell(stage, 0, len(keys))
            scan = self._scan_names
            tasks = [
                Task(scan[k[0]], scan[k[1]], self._pair_name(k, config), is_glance) for k in keys
            ]
            search_tasks(tasks, self._folder, config, self._workers)

    def _found(
        self, key: PairKey, config: RegistrationConfig, prior: Prior | None = None
    ) -> Outcome:
        """What searching a pair found before, or finds now."""
        name = self._pair_name(key, config, prior)
        outcome = self._pairs.load(name)
        if outcome is None:
            outcome = search(self._scans[key[1]], self._scans[key[0]], config, prior)
            self._pairs.save(name, outcome)
        return outcome

    def _pair_name(
        self, key: PairKey, config: RegistrationConfig, prior: Prior | None = None
    ) -> str:
        """Of the file of a search."""
        target, source = (self._digests[scan] for scan in key)
        size_m = self._scans[0].skipmap.voxel_size_m
        return pair_key((target, source), size_m, self._seed, config, prior)
