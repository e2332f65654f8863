"""Options of ``evaluate.py``."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from skipnet.checks import require
from skipnet.networks.names import weights_file


class DatasetKind(Enum):
    """Where the pairs of a benchmark come from; all but the first two read a folder."""

    simulated = "simulated"
    overlapping = "overlapping"
    """Simulated too, with an overlap that is chosen: most of the pairs have 10 to 30 %."""
    folder = "folder"
    """Any folder with a pairs.json."""
    threedmatch = "threedmatch"
    threedlomatch = "threedlomatch"
    kitti = "kitti"
    eth = "eth"
    """Gazebo and wood, as 3DSmoothNet ships them."""
    asl = "asl"
    """ASL's own csv files."""
    redwood = "redwood"
    whu_tls = "whu_tls"
    scans = "scans"
    """Scans beside their poses, as in RESSO."""


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
class VariantConfig:
    """One method of a benchmark: an adapter with its options."""

    adapter: str = "skipnet"
    """skipnet, icp, open3d (FPFH + RANSAC or FGR), matching (descriptors + SC2-PCR), kiss_matcher
    or small_gicp."""
    label: str = ""
    """Its name in tables and figures; empty takes the key under which it stands."""
    group: str = ""
    """Variants with a group in common get one more row: on each set the best of them."""
    start_from: str = ""
    """For local methods: start at this one's coarse pose; empty starts at identity."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of the adapter; of skipnet: any field of the registration's config."""


def standard_variants() -> dict[str, VariantConfig]:
    """The methods every benchmark knows; ``methods=[...]`` chooses among them."""
    return {
        "skipnet": VariantConfig("skipnet", "skipnet"),
        "icp": VariantConfig("icp", "ICP directly"),
        "icp_plane": VariantConfig("icp", "ICP to planes directly", options={"to_planes": True}),
        # Unlimited, what only one scan saw pulls even a right pose off by 0.2 m: a fair reach.
        "icp_from_coarse": VariantConfig(
            "icp", "ICP from our coarse pose", start_from="skipnet", options={"max_distance_m": 0.1}
        ),
        "fpfh_ransac": VariantConfig("open3d", "FPFH + RANSAC + ICP"),
        "fgr": VariantConfig("open3d", "FPFH + FGR + ICP", options={"search": "fgr"}),
        "fpfh_sc2": VariantConfig("matching", "FPFH + SC2-PCR + ICP"),
        "learned_sc2": VariantConfig(
            "matching", "our descriptor + SC2-PCR + ICP", options={"descriptor": "learned"}
        ),
        "kiss_matcher": VariantConfig("kiss_matcher", "KISS-Matcher + GICP"),
        "kiss_alone": VariantConfig("kiss_matcher", "KISS-Matcher", options={"fine": False}),
        "small_gicp": VariantConfig("small_gicp", "GICP directly"),
    }


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

    def __post_init__(self) -> None:
        require(self.noise_m >= 0, "noise_m", self.noise_m, "metres of at least 0")
        require(0 < self.keep <= 1, "keep", self.keep, "above 0, at most 1")
        require(0 <= self.crop < 1, "crop", self.crop, "at least 0, below 1")


@dataclass
class SpeedConfig:
    """What ``benchmark=speed`` measures."""

    families: list[str] = field(default_factory=lambda: ["paper_room", "facade"])
    """Simulated families of scenes."""
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
        require(bool(self.families), "speed.families", self.families, "at least one family")
        sizes = self.points
        ascending = bool(sizes) and min(sizes) > 0 and sorted(sizes) == list(sizes)
        require(ascending, "speed.points", sizes, "whole numbers above 0, ascending")
        require(self.repeats > 0, "speed.repeats", self.repeats, "1 or more")


@dataclass
class EvaluateConfig:
    """Options of ``evaluate.py``: methods compared on the same pairs."""

    benchmark: str = "paper"
    """Name of the benchmark: a file in configs/benchmark."""
    dataset: DatasetKind = DatasetKind.simulated
    """Simulated scenes, or the layout of a folder of real scans."""
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
    methods: list[str] = field(default_factory=lambda: ["skipnet", "icp", "icp_from_coarse"])
    """Methods to run, in this order; each is a key of variants."""
    variants: dict[str, VariantConfig] = field(default_factory=standard_variants)
    """Every method that can be chosen."""
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
        if self.weights is not None:
            self._add_weights(self.weights)
        self._check_methods()

    def _add_weights(self, weights: str) -> None:
        weights_file(weights, "weights")
        options = {"descriptor": "learned", "weights": weights}
        label = f"{weights} + SC2-PCR + ICP"
        self.variants["other_weights"] = VariantConfig("matching", label, options=options)
        both = ("learned_sc2", "other_weights")
        self.methods += [name for name in both if name not in self.methods]

    def _check_methods(self) -> None:
        require(bool(self.methods), "methods", self.methods, "at least one method")
        for index, name in enumerate(self.methods):
            if name not in self.variants:
                raise ValueError(f"unknown method {name!r}: choose from {', '.join(self.variants)}")
            start = self.variants[name].start_from
            if start and start not in self.methods[:index]:
                raise ValueError(f"{name} starts from {start}: put {start} before it in methods")
