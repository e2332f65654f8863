"""Options of ``evaluate.py``."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from skipnet.checks import check_known, require
from skipnet.networks.names import weights_file
from skipnet.progress import Terminal

METHODS_GROUP = "skipnet.methods"
"""Of entry points that other packages declare."""
MISSING: Any = "???"
"""OmegaConf's mark of an option that must be given."""


class ProtocolKind(Enum):
    """By which rule a pose counts as right (``skipnet.benchmark.scoring.protocols``)."""

    own = "own"
    """Each pair's own thresholds."""
    rmse_20cm = "rmse_20cm"
    """3DMatch: RMSE below 0.2 m through gt.info, non-consecutive pairs, mean of scenes."""
    deg15_30cm = "deg15_30cm"
    """3DMatch, the other rule: 15 degrees and 0.3 m, all pairs."""
    deg5_2m = "deg5_2m"
    """KITTI."""
    deg5_60cm = "deg5_60cm"
    """KITTI, the stricter rule."""
    deg2_30cm = "deg2_30cm"
    """ETH."""


@dataclass
class MethodConfig:
    """One method of a benchmark: a function that builds it, with its options."""

    make: str = MISSING
    """Dotted path of that function: skipnet.benchmark.methods.NAME.make, or one of your own."""
    label: str = ""
    """Its name in tables and figures; empty takes the key under which it stands."""
    group: str = ""
    """Methods with a group in common get one more row: on each set the best of them."""
    start_from: str = ""
    """For local methods: start at this one's coarse pose; empty starts at identity."""
    options: dict[str, Any] = field(default_factory=dict)
    """What the function takes; that of skipnet takes any field of the registration's config."""


@dataclass
class DisturbanceConfig:
    """What is done to both scans of a pair before anyone sees them; a set of its own in tables."""

    name: str = "as scanned"
    """Its name in tables."""
    noise_m: float = 0.0
    """Standard deviation of noise added to every coordinate."""
    keep: float = 1.0
    """Share of the points that stay, drawn at random."""
    crop: float = 0.0
    """Share of each scan cut off by a plane, from opposite sides: less overlap."""
    passers_by: int = 0
    """Obstacles that stop beams of each scan, other ones in each; the sensors stand at the origins.
    """

    def __post_init__(self) -> None:
        require(self.noise_m >= 0, "noise_m", self.noise_m, "metres of at least 0")
        require(0 < self.keep <= 1, "keep", self.keep, "above 0, at most 1")
        require(0 <= self.crop < 1, "crop", self.crop, "at least 0, below 1")
        require(self.passers_by >= 0, "passers_by", self.passers_by, "0 or more")


@dataclass
class SpeedConfig:
    """What ``benchmark=speed`` measures."""

    families: list[str] = field(default_factory=lambda: ["paper_room", "facade"])
    """Simulated families of scenes."""
    kinds: list[str] = field(default_factory=list)
    """Kinds of pairs that are hard (``skipnet.simulation.scanning.hard``), each in its one size."""
    points: list[int] = field(
        default_factory=lambda: [50_000, 200_000, 1_300_000, 5_000_000, 10_000_000]
    )
    """Points per scan of each size, ascending; a scan has them within some per cent."""
    most_points: dict[str, int] = field(default_factory=dict)
    """Method to the largest size at which it runs; the others run at all."""
    voxels_m: dict[str, dict[str, float]] = field(default_factory=dict)
    """Family to each method's ``voxel_size_m`` there; the others choose their own."""
    repeats: int = 3
    """Times that each method runs on a pair, in turns with the others; the middle one counts."""
    memory: bool = True
    """Measure the peak memory too: each method once more per size, in a process of its own."""

    def __post_init__(self) -> None:
        asked = self.families + self.kinds
        require(bool(asked), "speed.families", asked, "at least one family, or speed.kinds")
        sizes = self.points
        ascending = bool(sizes) and min(sizes) > 0 and sorted(sizes) == list(sizes)
        require(ascending, "speed.points", sizes, "whole numbers above 0, ascending")
        require(self.repeats > 0, "speed.repeats", self.repeats, "1 or more")


@dataclass
class EvaluateConfig:
    """Options of ``evaluate.py``: methods compared on the same pairs."""

    benchmark: str = "paper"
    """Name of the benchmark: a file in configs/benchmark."""
    dataset: str = "skipnet.benchmark.datasets.simulated.Simulated"
    """Where the pairs come from; dataset=NAME takes configs/dataset/NAME.yaml, which gives here the
    dotted path of what makes a ``Dataset`` of these options."""
    protocol: ProtocolKind | None = None
    """Rule by which a pose counts as right; null takes the data set's own."""
    seed: int = 0
    """Simulated: number of the first scene, among those that nothing was made from
    (``skipnet.simulation.seeds``). Folder: seed of the random motions."""
    family: str = "paper_room"
    """Simulated: family of scenes; all takes every one whose scans have one answer only."""
    pairs: int = 40
    """Simulated: number of pairs of a family; overlapping: of each kind of scans."""
    scanner: str = "terrestrial"
    """Simulated: preset of the scanner."""
    rotation: str = "yaw"
    """Simulated: yaw keeps the second scanner upright, any turns it freely."""
    points: int | None = None
    """Simulated: beams per scan; null takes the scanner's own number."""
    data: str | None = None
    """Folder: the folder that holds the data set, relative to where the user stands."""
    sets: list[str] = field(default_factory=list)
    """Folder: names of the sets, scenes or sequences to use; empty takes all."""
    most_per_set: int | None = None
    """Folder: at most so many pairs of each set, spread over its list; null takes all."""
    turn: bool = True
    """Folder: first turn each source about its origin by a random rotation."""
    shift_m: float = 0.0
    """Folder: then shift it by this length in a random direction, away from its viewpoint."""
    disturbances: list[DisturbanceConfig] = field(default_factory=list)
    """Each pair once with each of them; empty leaves the pairs alone."""
    methods: dict[str, MethodConfig] = field(default_factory=dict)
    """What is compared, in this order; methods=[NAME,NAME] takes configs/methods/NAME.yaml."""
    outside: list[str] = field(default_factory=list)
    """Methods from outside the package, compared too: names of entry points in the group
    skipnet.methods, or FILE.py:FUNCTION."""
    weights: str | None = None
    """A network, by name or file of train.py: adds matching on it, and on the shipped one, to the
    methods."""
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    """benchmark=speed: the sizes of its scans, and what of each to measure."""
    time_limit_s: float | None = 300.0
    """A method that takes longer on a pair is stopped and has failed there; null never stops."""
    threads: int = 1
    """Processors that a method may use; each method has a process of its own."""
    inlier_distance_m: float | None = None
    """A correspondence is an inlier below it; null takes two voxels of the size found in the data.
    """
    worst: int = 3
    """Pairs of the first method that the report shows before and after, the worst first."""
    terminal: Terminal = Terminal.table
    """table: a bar, then what came out; quiet: errors alone; json: one line of JSON."""
    output_dir: str = "runs/evaluate"
    """Folder of this run, relative to where the user stands; give an earlier one to resume it."""

    def __post_init__(self) -> None:
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        require(self.pairs >= 1, "pairs", self.pairs, "a whole number of at least 1")
        require(self.shift_m >= 0, "shift_m", self.shift_m, "metres of at least 0")
        limit_s = self.time_limit_s
        require(limit_s is None or limit_s > 0, "time_limit_s", limit_s, "seconds above 0, or null")
        require(self.threads >= 1, "threads", self.threads, "1 or more")
        distance_m = self.inlier_distance_m
        is_length = distance_m is None or distance_m > 0
        require(is_length, "inlier_distance_m", distance_m, "metres above 0, or null")
        require(self.worst >= 0, "worst", self.worst, "0 or more")
        most = self.most_per_set
        require(most is None or most >= 1, "most_per_set", most, "1 or more, or null")
        names = [disturbance.name for disturbance in self.disturbances]
        require(len(set(names)) == len(names), "disturbances", names, "different names")
        for name in self.outside:
            self._add_outside(name)
        if self.weights is not None:
            self._add_weights(self.weights)
        self._check_methods()

    def _add_outside(self, given: str) -> None:
        """A method by the name of an entry point or by its file; it builds with its defaults."""
        if ".py:" in given:
            make, name = given, Path(given.rpartition(":")[0]).stem
        else:
            found = {point.name: point.value for point in entry_points(group=METHODS_GROUP)}
            check_known("outside", given, tuple(found) or ("FILE.py:FUNCTION",))
            make, name = found[given].replace(":", "."), given
        self.methods.setdefault(name, MethodConfig(make))

    def _add_weights(self, weights: str) -> None:
        weights_file(weights, "weights")
        make, learned = "skipnet.benchmark.methods.matching.make", {"descriptor": "learned"}
        shipped = MethodConfig(make, "our descriptor + SC2-PCR + ICP", options={**learned})
        options = {**learned, "weights": weights}
        self.methods.setdefault("learned_sc2", shipped)
        label = f"{weights} + SC2-PCR + ICP"
        self.methods["other_weights"] = MethodConfig(make, label, options=options)

    def _check_methods(self) -> None:
        before: list[str] = []
        for name, method in self.methods.items():
            start = method.start_from
            if start and start not in before:
                raise ValueError(f"{name} starts from {start}: put {start} before it in methods")
            before.append(name)
