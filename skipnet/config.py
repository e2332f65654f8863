"""Every option of every script, with default, unit and range: the schemas Hydra checks against.

A range is checked when the dataclass is made, so a bad value fails before any work is done.
Algorithms never see these classes: they take plain arrays and scalars.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any


def require(condition: bool, option: str, value: object, expected: str) -> None:
    """Raise a ValueError that names the option, what was given and what is expected.

    >>> require(False, "seed", -1, "a whole number of at least 0")
    Traceback (most recent call last):
    ...
    ValueError: seed=-1: expected a whole number of at least 0
    """
    if not condition:
        raise ValueError(f"{option}={value}: expected {expected}")


def check_viewpoint(option: str, value: object) -> None:
    """A viewpoint is "auto", None (unknown), or the sensor's position [x, y, z] in metres."""
    is_position = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(number, int | float) for number in value)
    )
    require(value is None or value == "auto" or is_position, option, value, "auto, null or [x,y,z]")


# --- registration ---------------------------------------------------------------------------------


class Generator(Enum):
    """Where candidate poses come from."""

    corners = "corners"
    edges = "edges"
    planes = "planes"
    slides = "slides"
    descriptors = "descriptors"
    """The learned ones."""
    fpfh = "fpfh"
    """Descriptors computed by a fixed rule, for comparison; slower, and Open3D's."""


@dataclass
class RegistrationConfig:
    """Options of the registration itself; the defaults serve any scan."""

    generators: list[Generator] = field(
        default_factory=lambda: [Generator.planes, Generator.slides, Generator.descriptors]
    )
    """Asked in this order; a later one only while the verdict is not clear yet."""
    denoise: bool = False
    """Drop outliers first, as the paper does. Effective voxels do without."""
    denoise_neighbours: int = 4
    """Nearest neighbours whose mean distance is looked at."""
    denoise_sigma: float = 1.0
    """Standard deviations above the mean from which a point is dropped."""
    same_class_corners: bool = True
    """Only corners of equal class correspond, as in the paper; false lets any two."""
    feature_weight: float = 1.0
    """Weight of edge and corner voxels in the judge, where planes have 1; 1 asks no network."""
    violation_weight: float = 10.0
    """How fast voxels in seen free space devalue a pose: 1 / weight of all leave it 37 %."""
    max_correspondences: int = 1500
    """Descriptor matches that enter the compatibility graph."""
    refine_samples: int = 1500
    """Voxels with which candidates are refined before the final judgement."""
    final_samples: int = 4000
    """Voxels of each scan that the final judgement looks at."""

    def __post_init__(self) -> None:
        require(bool(self.generators), "generators", self.generators, "at least one generator")
        require(self.violation_weight >= 0, "violation_weight", self.violation_weight, "0 or more")
        neighbours = self.denoise_neighbours
        require(neighbours >= 1, "denoise_neighbours", neighbours, "1 or more")


# --- register.py ----------------------------------------------------------------------------------


@dataclass
class RegisterConfig:
    """Options of ``register.py``: two scans, many scans, or none: a simulated pair."""

    source: str | None = None
    """The scan to move (.ply .pcd .xyz .txt .csv .npy .npz .las .laz .e57), in metres."""
    target: str | None = None
    """The scan that stays."""
    scans: list[str] = field(default_factory=list)
    """Two or more scans to bring into the frame of the first, instead of source and target."""
    output_dir: str = "runs/register"
    """Where the results are written, relative to where the user stands; made when missing."""
    source_viewpoint: Any = "auto"
    """Sensor position in the source's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    target_viewpoint: Any = "auto"
    """Sensor position in the target's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    voxel_size_m: float | None = None
    """Voxel edge length in metres; null chooses it from the data."""
    seed: int = 0
    """Seed of every random choice: the same input and seed give the same bits."""
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    """How to register."""

    def __post_init__(self) -> None:
        check_viewpoint("source_viewpoint", self.source_viewpoint)
        check_viewpoint("target_viewpoint", self.target_viewpoint)
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        size_m = self.voxel_size_m
        require(size_m is None or size_m > 0, "voxel_size_m", size_m, "metres above 0, or null")
        self._check_inputs()

    def _check_inputs(self) -> None:
        if (self.source is None) != (self.target is None):
            given = "source" if self.target is None else "target"
            raise ValueError(f"only {given} was given: give source=FILE and target=FILE together")
        if self.scans and self.source is not None:
            raise ValueError("scans=[...] and source=/target= exclude each other: give only one")
        require(len(self.scans) != 1, "scans", self.scans, "at least two files")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")

    @property
    def inputs(self) -> list[Path]:
        """The files to read, in the order given; empty when a pair is to be simulated."""
        if self.source is not None and self.target is not None:
            return [Path(self.source), Path(self.target)]
        return [Path(scan) for scan in self.scans]


# --- train.py -------------------------------------------------------------------------------------


class PatchKind(Enum):
    """How a voxel's surroundings become 125 numbers (``skipnet.features.patches``)."""

    surface_frame = "surface_frame"
    axis_aligned = "axis_aligned"


class Activation(Enum):
    """What a hidden unit does with its sum."""

    tanh = "tanh"
    gelu = "gelu"


class InputScaling(Enum):
    """How the network's inputs are brought to one scale."""

    standard = "standard"
    minmax = "minmax"


class Split(Enum):
    """What training, validation and test sets share."""

    by_scene = "by_scene"
    random = "random"


@dataclass
class LabelConfig:
    """What counts as a surface at a voxel; lengths in voxels."""

    radius_voxels: float = 2.5
    """A surface farther away does not count: half the width of 5 voxels."""
    min_area_voxels2: float = 3.0
    """Nor does one of which the sensor sees less there; a flat wall shows 19.6."""
    min_beams: float = 6.0
    """Nor one that fewer of the scanner's beams meet there."""

    def __post_init__(self) -> None:
        require(self.radius_voxels > 0, "label.radius_voxels", self.radius_voxels, "above 0")
        require(self.min_area_voxels2 >= 0, "label.min_area_voxels2", self.min_area_voxels2, "0 up")
        require(self.min_beams >= 0, "label.min_beams", self.min_beams, "0 or more")


@dataclass
class DataConfig:
    """Where the labelled patches come from."""

    families: list[str] = field(
        default_factory=lambda: ["paper_room", "oblique", "doorway", "closed", "curved"]
    )
    """Simulated families, taken in turn (``skipnet.simulation.scenes.FAMILIES``)."""
    scanner: str = "terrestrial"
    """terrestrial or rings."""
    turn_second_scan: bool = True
    """Turn each scene's second cloud at random; false keeps it upright, as in the paper."""
    patch: PatchKind = PatchKind.surface_frame
    """surface_frame, or axis_aligned as in the paper."""
    label: LabelConfig = field(default_factory=LabelConfig)
    """The definition of the classes."""
    split: Split = Split.by_scene
    """by_scene, or random: 70 % training, 15 % validation, 15 % test of the same scenes' voxels."""
    training_scenes: int = 160
    """Scenes with seeds from 0, two scans each."""
    validation_scenes: int = 15
    """Scenes with seeds from 1000; unused by split=random."""
    test_scenes: int = 40
    """Scenes with seeds from 2000, never seen in training, whatever the split."""
    most_per_class: int = 150
    """Training and validation voxels kept of each class and scan; the test keeps all."""
    samples: int | None = None
    """Samples in all, the same number of each class; null keeps all."""
    workers: int = 2
    """Processes that simulate; the data do not depend on their number."""

    def __post_init__(self) -> None:
        require(bool(self.families), "data.families", self.families, "at least one family")
        for name in ("training_scenes", "validation_scenes", "test_scenes"):
            count = getattr(self, name)
            require(0 < count <= 1000, f"data.{name}", count, "1 to 1000: seeds must not overlap")
        for name in ("most_per_class", "workers"):
            require(getattr(self, name) > 0, f"data.{name}", getattr(self, name), "1 or more")
        samples = self.samples
        require(samples is None or samples >= 50, "data.samples", samples, "50 or more, or null")


class NetworkKind(Enum):
    """Which network ``train.py`` trains."""

    classifier = "classifier"
    descriptor = "descriptor"


class Loss(Enum):
    """What the descriptor's training minimises."""

    contrastive = "contrastive"
    """InfoNCE: the partner against all other places of the batch."""
    hardest = "hardest"
    """A hinge on the most similar wrong place alone."""


@dataclass
class AugmentationConfig:
    """How the descriptor's training pairs are scanned and spoilt; shares are of pairs of scans."""

    rings_share: float = 0.25
    """Taken by a spinning scanner of 16 channels."""
    camera_share: float = 0.25
    """Seen by two cameras of a narrow view that look at about the same point."""
    fused_share: float = 0.2
    """Fused from two places each: nothing says which side of a surface was seen."""
    aim_error: float = 0.2
    """How far apart the cameras aim, as a share of their distance from the point."""
    voxel_octaves: float = 1.0
    """The usual voxel size is multiplied by a power of two between minus and plus this."""
    noise_voxels: list[float] = field(default_factory=lambda: [0.0, 0.05, 0.15])
    """Deviations of the points' noise, in voxels, one of which is drawn for a pair."""
    least_kept: float = 0.3
    """Of a scan's points between this share and all are kept."""
    holes: int = 6
    """Up to so many balls of points, of 2 to 12 voxels, are taken out of each scan."""
    curved_share: float = 0.8
    """So many of the examples are drawn by curvature; the rest evenly."""
    turned_share: float = 0.4
    """Shown with all their surfaces seen from the back."""

    def __post_init__(self) -> None:
        for name in ("rings_share", "camera_share", "fused_share", "curved_share", "turned_share"):
            share = getattr(self, name)
            require(0 <= share <= 1, f"descriptor.augmentation.{name}", share, "0 to 1")
        shares = self.rings_share + self.camera_share + self.fused_share
        require(shares <= 1, "descriptor.augmentation shares", shares, "at most 1 together")
        kept = self.least_kept
        require(0 < kept <= 1, "descriptor.augmentation.least_kept", kept, "above 0, at most 1")
        noise = self.noise_voxels
        known = bool(noise) and min(noise) >= 0
        require(known, "descriptor.augmentation.noise_voxels", noise, "one or more of 0 or more")
        for name in ("aim_error", "voxel_octaves", "holes"):
            value = getattr(self, name)
            require(value >= 0, f"descriptor.augmentation.{name}", value, "0 or more")


@dataclass
class DescriptorTrainConfig:
    """What ``train.py experiment=descriptor`` learns from, and how."""

    families: list[str] = field(
        default_factory=lambda: [
            "paper_room",
            "oblique",
            "curved",
            "doorway",
            "closed",
            "facade",
            "terrain",
            "clutter",
        ]
    )
    """Simulated families, taken in turn (``skipnet.simulation.scenes.FAMILIES``)."""
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    """How their scans are taken and spoilt; also those of validation and test."""
    training_pairs: int = 420
    """Pairs of scans with seeds from 0."""
    validation_pairs: int = 16
    """Pairs of scans with seeds from 10000."""
    test_pairs: int = 32
    """Pairs of scans with seeds from 20000, for the scores."""
    patches_per_scans: int = 600
    """Pairs of patches drawn from one pair of scans."""
    steps: int = 3000
    """Steps of the optimiser at most."""
    scans_per_step: int = 2
    """Pairs of scans whose patches meet in one step."""
    patches_per_step: int = 768
    """Pairs of patches of one step, from all its scans."""
    learning_rate: float = 0.003
    """Its maximum; it rises for a tenth of the steps, then falls to 0 along half a cosine."""
    loss: Loss = Loss.contrastive
    """contrastive, or hardest; loss=NAME takes configs/loss."""
    temperature: float = 0.07
    """Cosine similarity that changes the odds of a match e-fold."""
    sector_units: int = 48
    """Units that sum up one sector of a patch."""
    hidden_units: int = 128
    """Units that read the five sectors together."""
    output_units: int = 32
    """Numbers of a descriptor."""
    validate_every: int = 250
    """Steps between validations; at each a checkpoint is written, from which a run resumes."""
    patience: int = 5
    """Validations without a higher inlier ratio after which training ends; 0 never ends early."""
    workers: int = 2
    """Processes that simulate; the data do not depend on their number."""

    def __post_init__(self) -> None:
        require(bool(self.families), "descriptor.families", self.families, "at least one family")
        for name in ("training_pairs", "validation_pairs", "test_pairs"):
            count = getattr(self, name)
            limit = 10_000
            require(0 < count <= limit, f"descriptor.{name}", count, f"1 to {limit}")
        counts = ("patches_per_scans", "steps", "scans_per_step", "validate_every", "workers")
        for name in (*counts, "sector_units", "hidden_units", "output_units"):
            require(getattr(self, name) > 0, f"descriptor.{name}", getattr(self, name), "1 or more")
        per_step = self.patches_per_step
        least = 2 * self.scans_per_step
        require(per_step >= least, "descriptor.patches_per_step", per_step, f"{least} or more")
        for name in ("learning_rate", "temperature"):
            require(getattr(self, name) > 0, f"descriptor.{name}", getattr(self, name), "above 0")
        require(self.patience >= 0, "descriptor.patience", self.patience, "0 or more")


@dataclass
class TrainConfig:
    """Options of ``train.py``."""

    experiment_name: str = "scenes"
    """Its name in reports."""
    network: NetworkKind = NetworkKind.classifier
    """classifier of feature voxels, or descriptor: of the options below, it takes only
    ``descriptor``, ``seed``, ``ship`` and ``output_dir``."""
    descriptor: DescriptorTrainConfig = field(default_factory=DescriptorTrainConfig)
    """How to train the descriptor."""
    data: DataConfig = field(default_factory=DataConfig)
    """What to learn from."""
    hidden_sizes: list[int] = field(default_factory=lambda: [192, 96])
    """Units of each hidden layer; the paper's network is [50]."""
    activation: Activation = Activation.gelu
    """gelu, or tanh as in the paper's network (MATLAB's tansig)."""
    dropout: float = 0.2
    """Share of the hidden units that training leaves out at random; 0 none."""
    input_scaling: InputScaling = InputScaling.standard
    """standard: mean 0, deviation 1; minmax: to [-1, 1], MATLAB's mapminmax."""
    optimizer: dict[str, Any] = field(default_factory=dict)
    """``_target_`` and arguments of a torch optimiser; optimizer=NAME takes configs/optimizer."""
    learning_rate: float = 0.003
    """Of the optimisers that have one; scaled conjugate gradient has none, as in MATLAB."""
    cosine_decay: bool = True
    """Let the learning rate fall to 0 over the epochs."""
    batch_size: int | None = 512
    """Samples per step; null takes all at once, as MATLAB does."""
    epochs: int = 25
    """Passes over the training set at most."""
    goal: float = 0.0
    """Training loss at which to stop: cross-entropy averaged over outputs and samples."""
    min_gradient: float = 0.0
    """Stop when the full batch's gradient is shorter; 0 never."""
    max_fail: int = 0
    """Stop after so many epochs above the lowest validation loss; 0 never."""
    frequency_strength: float = 0.75
    """A thinned class gets back this power of what thinning took: 1 as in the scan, 0 nothing."""
    double_precision: bool = False
    """Train in float64; scaled conjugate gradient needs it. Weights are stored in float32."""
    ship: bool = False
    """Put the weights and their card into the package too, as those that skipnet.register uses."""
    compare_sklearn: bool = False
    """Train scikit-learn's classifiers on the same samples, for the same tables."""
    seed: int = 0
    """Of the weights' start, the order of the batches, the random split and the peers."""
    output_dir: str = "runs/train"
    """Folder of the run, relative to where the user stands; a descriptor's that was interrupted
    goes on where it was."""

    def __post_init__(self) -> None:
        sizes = self.hidden_sizes
        require(bool(sizes) and min(sizes) > 0, "hidden_sizes", sizes, "positive layer sizes")
        require(self.learning_rate > 0, "learning_rate", self.learning_rate, "above 0")
        require(0 <= self.dropout < 1, "dropout", self.dropout, "0 or more and below 1")
        batch = self.batch_size
        require(batch is None or batch > 0, "batch_size", batch, "1 or more, or null for all")
        require(self.epochs > 0, "epochs", self.epochs, "1 or more")
        for name in ("goal", "min_gradient", "max_fail", "frequency_strength", "seed"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")
        require("_target_" in self.optimizer, "optimizer", self.optimizer, "a torch optimiser")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")


# --- evaluate.py ----------------------------------------------------------------------------------


class DatasetKind(Enum):
    """Where the pairs of a benchmark come from; all but simulated read a folder."""

    simulated = "simulated"
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
    """By which rule a pose counts as right (``skipnet.benchmark.protocols``)."""

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
    beams: list[int] = field(
        default_factory=lambda: [50_000, 200_000, 1_300_000, 5_000_000, 10_000_000]
    )
    """Beams per scan of each size, ascending."""
    most_beams: dict[str, int] = field(default_factory=dict)
    """Method to the largest size at which it runs; the others run at all."""
    voxels_m: dict[str, dict[str, float]] = field(default_factory=dict)
    """Family to each method's ``voxel_size_m`` there; the others choose their own."""
    memory: bool = True
    """Measure the peak memory too: each method once more per size, in a process of its own."""

    def __post_init__(self) -> None:
        require(bool(self.families), "speed.families", self.families, "at least one family")
        beams = self.beams
        ascending = bool(beams) and min(beams) > 0 and sorted(beams) == list(beams)
        require(ascending, "speed.beams", beams, "whole numbers above 0, ascending")


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
    """Simulated: seed of the first pair (pair i has seed + i). Folder: of the random motions."""
    family: str = "paper_room"
    """Simulated: family of scenes; all takes every one whose scans have one answer only."""
    pairs: int = 40
    """Simulated: number of pairs of a family."""
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
    """A descriptor.npz that train.py wrote: adds matching on it, and on the shipped one, to the
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
        require(Path(weights).is_file(), "weights", weights, "a descriptor.npz of train.py")
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
