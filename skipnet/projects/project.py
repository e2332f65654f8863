"""Many scans, one model: scans are added, pairs are searched once, links are weighed together."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace

from skipnet.checks import as_path, check_seed, require
from skipnet.networks.catalog import find_network
from skipnet.projects.arbiter import Known
from skipnet.projects.assembly import Assembly
from skipnet.projects.blocks import Workers
from skipnet.projects.deciding import assemble, between_given, decide
from skipnet.projects.decision import Decision
from skipnet.projects.doubts import is_sure
from skipnet.projects.groups import Joiner
from skipnet.projects.priors import Priors
from skipnet.projects.retrieval import worth_searching
from skipnet.projects.schedule import Outcome, cheap, costly
from skipnet.projects.searches import Progress, Searches
from skipnet.projects.store import SizeStore, digest
from skipnet.projects.ways import PairKey
from skipnet.projects.witness import Witness
from skipnet.registration.options import RegistrationConfig, as_config
from skipnet.registration.pipeline import clean
from skipnet.registration.prior import Prior
from skipnet.registration.stopwatch import Stopwatch
from skipnet.scans.describing import describe
from skipnet.scans.given import ScanLike, opened, taken
from skipnet.scans.scan import Scan, Viewpoint
from skipnet.scans.store import ScanStore, scan_key
from skipnet.skipmap.tree import Points, check_voxel_size


class Project:
    """Scans of one or several scenes, added in any order.

    Example::

        project = skipnet.Project("out/project")
        for path in paths:
            project.add(path)
        model = project.solve()  # after another project.add it searches the new pairs only
    """

    def __init__(
        self,
        folder: str | os.PathLike[str] | None = None,
        *,
        voxel_size_m: float | None = None,
        seed: int = 0,
        config: RegistrationConfig | None = None,
        workers: Workers | None = None,
        priors: Priors | None = None,
    ) -> None:
        """Begin a project.

        Args:
            folder: where what was described and searched is kept, so that a run that was ended goes
                on where it was; None keeps it in memory only.
            voxel_size_m: edge of a voxel; None chooses it once, when they are first solved.
            seed: of every random choice.
            config: everything else; None takes the defaults.
            workers: who searches the pairs; None: this process.
            priors: what somebody believes of the scans, by their numbers: judged, never trusted.

        Raises:
            ValueError: the voxel size is no length, or other processes have no folder to share.
        """
        check_seed(seed)
        self._workers = Workers() if workers is None else workers
        require(isinstance(self._workers, Workers), "workers", workers, "skipnet.Workers or None")
        self._priors = Priors() if priors is None else priors
        require(isinstance(self._priors, Priors), "priors", priors, "skipnet.Priors or None")
        folder = None if folder is None else as_path(folder, "folder")
        if folder is None and not self._workers.is_here:
            raise ValueError(f"{self._workers} without a folder: expected one that they share")
        if voxel_size_m is not None:
            check_voxel_size(voxel_size_m)
        self.voxel_size_m = voxel_size_m
        self._seed = seed
        self._config = as_config(config)
        self._folder = folder
        self._given: list[tuple[Points, Viewpoint]] = []  # until they are described
        self._originals: list[ScanLike] = []
        """What was added; a path stays a path."""
        self._digests: list[str] = []
        self._scans: list[Scan] = []
        self._scan_names: list[str] = []
        """Of their files, where there is a folder."""
        self._searches = Searches(
            folder, seed, self._workers, self._scans, self._scan_names, self._digests
        )
        self.joiner: Joiner | None = None
        """What pairs proposed, once it is solved."""

    def __len__(self) -> int:
        """How many scans there are."""
        return len(self._digests)

    def add(self, scan: ScanLike, viewpoint: Viewpoint = "auto") -> int:
        """Add a scan; return its number.

        Args:
            scan: as ``skipnet.register`` takes it.
            viewpoint: sensor position in the scan's frame, likewise.

        Raises:
            ValueError: it is no point cloud.
        """
        number = len(self)
        cloud = opened(scan, f"scans[{number}]")
        cloud_m, viewpoint = taken(cloud, viewpoint, f"scans[{number}]", f"viewpoints[{number}]")
        self._given.append((cloud_m, viewpoint))
        self._originals.append(scan if isinstance(scan, str | os.PathLike) else cloud)
        self._digests.append(digest(cloud_m, viewpoint))
        return number

    def solve(self, progress: Progress | None = None) -> Assembly:
        """Search the pairs that have not been searched, and decide where every scan stands.

        Every pair is asked with the cheap generators; where groups remain that nothing joins, a few
        pairs between them are asked with the costly ones. Neither the order of the work nor where
        it was interrupted changes the result.

        Raises:
            ValueError: fewer than two scans, or priors of scans that are not there.
        """
        if len(self) < 2:
            raise ValueError(f"got {len(self)} scans: expected two or more")
        self._priors.check(len(self))
        tell = progress or (lambda stage, done, of: None)
        clock = Stopwatch()
        with clock("skip-map"):
            self._describe()
        with clock("pairs"):
            keys = self._searches.worthwhile(self._priors, cheap(self._config), tell)
            hopeful = sorted(keys, key=lambda key: (self._priors.apart_m(key), key))
            self._searches.search(hopeful, cheap(self._config), 0, "pairs", tell)
        witness = Witness([scan.evidence for scan in self._scans])
        more = costly(self._config)
        chosen = sorted(self._priors.linked) if more is not None else []
        with clock("pairs"):
            guesses = self._priors.guesses(2 * max(witness.reach_m))
            found = self._searches.search_about(guesses, cheap(self._config), tell)
            about = {key: [outcome] for key, outcome in found.items()}
            if more is not None:
                self._searches.search(chosen, more, 1, "pairs said to overlap", tell)
        known: Known = {}
        joiner, decision = self._decide(witness, known, keys, chosen, about, tell, clock)
        if more is not None and len(decision.groups) > 1:
            with clock("pairs"):
                chosen = sorted({*chosen, *worth_searching(decision, joiner, self._priors)})
                self._searches.search(chosen, more, 1, "pairs between groups", tell)
            joiner, decision = self._decide(witness, known, keys, chosen, about, tell, clock)
        with clock("pose graph"):
            used = self._known(keys, keys, about)
            result = assemble(decision, joiner, used, self._scans, clock.seconds)
        self.joiner = joiner
        return replace(result, given=tuple(self._originals), described=tuple(self._scans))

    def _describe(self) -> None:
        """Describe the scans that are new, with the project's voxel size."""
        if not self._given:
            return
        clouds_m = [clean(cloud_m, self._config) for cloud_m, _ in self._given]
        viewpoints = [viewpoint for _, viewpoint in self._given]
        network = find_network(self._config.network, self._config.device)
        if self._folder is None:
            self._scans += describe(clouds_m, viewpoints, self.voxel_size_m, self._seed, network)
            self.voxel_size_m = self._scans[0].skipmap.voxel_size_m
        else:
            size_m = SizeStore(self._folder).fixed_m(self.voxel_size_m, clouds_m, self._digests)
            self.voxel_size_m = size_m
            some = clouds_m, viewpoints, size_m, self._seed, network
            named = zip(clouds_m, viewpoints, strict=True)
            self._scan_names += [scan_key(one_m, place, *some[2:]) for one_m, place in named]
            self._scans += ScanStore(self._folder / "scans").describe(*some)
        self._given.clear()

    def _decide(
        self,
        witness: Witness,
        known: Known,
        keys: Sequence[PairKey],
        more: Sequence[PairKey],
        about: dict[PairKey, list[Outcome]],
        tell: Progress,
        clock: Stopwatch,
    ) -> tuple[Joiner, Decision]:
        """Groups from the first outcome of every pair, and from the second of some.

        Where the word of some pairs would settle whether groups belong together, these are asked
        about the poses that they would have, and if some register all is decided once more.

        Args:
            witness: asks scans about poses.
            known: configurations that were found; what is found here is added.
            keys: the pairs that count.
            more: those of which the second outcome counts.
            about: what searching pairs about poses found; what is asked here and sure is added.
            tell: told what is being done.
            clock: of the stages.
        """
        tell("groups", 0, 1)
        with clock("groups"):
            joiner, decision = decide(self._known(keys, more, about), self._scans, witness, known)
        with clock("pairs"):
            asked = {
                (a, b): Prior(between_given(self._scans[a], T, self._scans[b]))
                for (a, b), T in decision.unsure.items()
            }
            found = self._searches.search_about(asked, cheap(self._config), tell)
            sure = {key: one for key, one in found.items() if is_sure(one.result)}
        if sure:
            for key, outcome in sure.items():
                about.setdefault(key, []).append(outcome)
            tell("groups", 0, 1)
            with clock("groups"):
                joiner, decision = decide(
                    self._known(keys, more, about), self._scans, witness, known
                )
        return joiner, decision

    def _known(
        self,
        keys: Sequence[PairKey],
        more: Sequence[PairKey],
        about: Mapping[PairKey, list[Outcome]],
    ) -> dict[PairKey, list[Outcome]]:
        """The first outcome of every pair, the second of some, and those about poses.

        What earlier calls searched more stays out: the same scans give the same result, whether
        they came at once or one by one.
        """
        twice, known = set(more), {}
        for key in sorted({*keys, *about}):
            first = self._searches.known(key, 2 if key in twice else 1)
            known[key] = first + about.get(key, [])
        return known
